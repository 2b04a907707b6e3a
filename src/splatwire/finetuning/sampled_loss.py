"""Training loss in a fixed sample of the views, for comparing states of a fine-tuning."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from splatwire.finetuning.pictures import Pictures
from splatwire.finetuning.receptions import SimulatedReception
from splatwire.render import iterate_views
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

CHECK_VIEWS = 16
"""Maximum number of fitted views in which states of a fine-tuning are compared."""


@dataclass(frozen=True, eq=False)
class SampledLoss:
    """Measures the training loss of Gaussians in a fixed sample of views, with and without simulated packet losses.

    The loss of a view is its mean squared error, divided by the error of the same view at the start of the fine-tuning.

    Attributes:
        scene: Scene that provides the background, the origin and the antialiasing flag; its Gaussians are not used.
        pictures: The sampled views.
        receptions: Simulated packet losses. Each is applied to all views.
        min_divisor: Lower limit of the divisor. It replaces the error at the start if that error is smaller.
        initial_errors: Mean squared error of each view at the start of the fine-tuning. Row 0 is for views without
            packet loss. Row i + 1 is for views with the packet loss `receptions[i]`.
    """

    # The Gaussians of `scene` are ignored. All receptions together have the same weight as the views without packet
    # loss.

    scene: SplatScene
    pictures: Pictures
    receptions: tuple[SimulatedReception, ...]
    min_divisor: float
    initial_errors: Float[np.ndarray, "R V"]

    @staticmethod
    def create(
        scene: SplatScene,
        splats: Splats,
        pictures: Pictures,
        receptions: Sequence[SimulatedReception],
        min_divisor: float,
        rng: np.random.Generator,
    ) -> "SampledLoss":
        """Chooses views at random, and measures their errors at the start of the fine-tuning.

        Args:
            scene: The scene.
            splats: The Gaussians at the start, rounded.
            pictures: All pictures of the fine-tuning.
            receptions: Simulated packet losses; empty for none.
            min_divisor: Lower limit of the divisor. The error of a view is divided by its error at the start, or by
                this limit if the limit is larger.
            rng: Random generator for the choice of views.
        """
        count = pictures.cameras.num_views
        views = sorted(rng.permutation(count)[:CHECK_VIEWS].tolist())
        masks = None if pictures.masks is None else pictures.masks[views]
        sample = Pictures(pictures.cameras.select(views), pictures.images[views], masks)
        sampled = SampledLoss(scene, sample, tuple(receptions), min_divisor, np.ones((1 + len(receptions), len(views))))
        return replace(sampled, initial_errors=sampled._errors(splats))

    def loss(self, splats: Splats) -> float:
        """Returns the mean training loss of rounded Gaussians."""
        # It is at most 1 at the start.
        losses = (self._errors(splats) / np.maximum(self.initial_errors, self.min_divisor)).mean(axis=1)
        return float(losses[0] if len(losses) == 1 else (losses[0] + losses[1:].mean()) / 2)

    def _errors(self, splats: Splats) -> Float[np.ndarray, "R V"]:
        shown = [splats, *(reception.received_splats(splats) for reception in self.receptions)]
        return np.array([self._view_errors(each) for each in shown])

    def _view_errors(self, splats: Splats) -> list[float]:
        pictures, masks, errors = self.pictures, self.pictures.masks, []
        shown_scene = replace(self.scene, splats=splats, coding=None, hints=None)
        for view, image in enumerate(iterate_views(shown_scene, pictures.cameras)):
            difference = image - pictures.images[view].astype(np.float32) / 255
            if masks is not None:
                difference *= masks[view][:, :, None]
            errors.append(float(np.mean(np.square(difference, dtype=np.float64))))
        return errors
