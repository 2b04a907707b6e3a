"""Trains the scene-free concealer on the pictures of some scenes, for use on all others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.calibrate.checks import check_settings
from splatwire.calibrate.pseudo_loss import CalibrationData, without
from splatwire.conceal.scene_free import GainNetwork
from splatwire.conceal.scene_free.network import HIDDEN, gain_inputs
from splatwire.conceal.scene_free.surroundings import surroundings_of
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.model.gaussian_heads import SpawnedGaussians, spawn_gaussians, visible_anchors
from splatwire.render.backends import create_renderer
from splatwire.scene import Gaussians
from splatwire.train.schedule import half_cosine


@dataclass(frozen=True)
class SceneFreeConfig:
    """A training run.

    Attributes:
        steps: Steps of Adam; one picture of one loss of one scene each, the scenes in turn.
        learning_rate: At the start; falls to 0 along a cosine.
        drop_rates: Share of the packets that each pseudo-loss drops; as many losses per scene.
        hidden: Width of the networks.
        floor: Added to the squared error of a picture before the logarithm: about the error of a lossless render
            against a photo, below which an error does not show.
        seed: Seed of everything random.
    """

    steps: int = 240
    learning_rate: float = 3e-3
    drop_rates: tuple[float, ...] = (0.2, 0.2, 0.2, 0.1, 0.4)
    hidden: int = HIDDEN
    floor: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        rates = bool(self.drop_rates) and all(0 < rate < 1 for rate in self.drop_rates)
        check_settings(self, "a training", ("hidden",), steps=self.steps >= 0, drop_rates=rates)


def train_scene_free(
    scenes: Sequence[CalibrationData],
    config: SceneFreeConfig,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> GainNetwork:
    """Trains a network by the error of lossy, concealed pictures against lossless ones.

    The loss of a picture is `log(mean squared error + floor)`: each decibel counts alike in every scene and view.

    Args:
        scenes: What to learn from, with the cameras at the size at which pictures are compared.
        config: The run.
        progress: Called after each step with its number and its loss.

    Returns:
        The network after the last step.

    Raises:
        InvalidValueError: If there is no scene, or one has no cameras.
        DivergedError: If the loss is not finite.
    """
    if not scenes:
        raise InvalidValueError("a concealer cannot be trained on no scene")
    seeds = np.random.SeedSequence(config.seed).spawn(len(scenes))
    lessons = [_Lessons(scene, config, seed) for scene, seed in zip(scenes, seeds, strict=True)]
    network = GainNetwork(config.hidden, seed=config.seed)
    losses = [inputs for lesson in lessons for inputs in lesson.inputs]
    network.standardise(torch.cat([inputs.signature for inputs in losses]))
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate, betas=(0.95, 0.99))
    rng = torch.Generator().manual_seed(config.seed)
    for step in range(config.steps):
        lesson = lessons[step % len(lessons)]
        error = lesson.error(network, rng)
        loss = (error + config.floor).log()
        if not bool(loss.isfinite()):
            raise DivergedError(step + 1)
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * half_cosine(step / config.steps)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        if progress is not None:
            progress(step + 1, float(loss.detach()))
    return network.eval().requires_grad_(False)


class _Lessons:
    """Losses and views of one scene, with all that does not change while the network learns."""

    def __init__(self, data: CalibrationData, config: SceneFreeConfig, seeds: np.random.SeedSequence) -> None:
        if data.cameras is None:
            raise InvalidValueError("a concealer cannot be trained on a scene without cameras")
        self._scene, self._cameras = data.scene, data.cameras
        around = surroundings_of(data.context, torch.arange(data.scene.anchors.num_anchors))
        with torch.no_grad():
            self.inputs = [
                gain_inputs(without(data.context, known), around.select(known))
                for known in data.pseudo_losses(config.drop_rates, seeds)
            ]
        self._views: dict[int, tuple[SpawnedGaussians, Tensor]] = {}
        self._order: list[tuple[int, int]] = []

    def error(self, network: GainNetwork, rng: torch.Generator) -> Float[Tensor, ""]:
        """Mean squared error of the next picture; every loss meets every view before one comes again."""
        if not self._order:
            pairs = [(loss, view) for loss in range(len(self.inputs)) for view in range(self._cameras.num_views)]
            self._order = [pairs[place] for place in torch.randperm(len(pairs), generator=rng).tolist()]
        loss, view = self._order.pop()
        inputs = self.inputs[loss]
        spawned, reference = self._lossless(view)
        place = torch.full((self._scene.anchors.num_anchors,), -1)
        place[inputs.rows] = torch.arange(len(inputs.rows))
        place = place[spawned.anchor_index]
        arrived = place >= 0
        size, opacity = (gain.index_select(0, place[arrived]) for gain in network(inputs))
        drawn = _with_gains(_rows(spawned.gaussians, arrived), size, opacity)
        return ((self._draw(drawn, view) - reference) ** 2).mean()

    @torch.no_grad()
    def _lossless(self, view: int) -> tuple[SpawnedGaussians, Tensor]:
        if view not in self._views:
            cameras, scene = self._cameras, self._scene
            visible = visible_anchors(scene.anchors, cameras, view) & scene.anchors.mask.any(dim=1)
            center = cameras.centers[view].to(scene.anchors.positions)
            spawned = spawn_gaussians(scene.anchors, scene.heads, center, visible)
            self._views[view] = spawned, self._draw(spawned.gaussians, view)
        return self._views[view]

    def _draw(self, gaussians: Gaussians, view: int) -> Float[Tensor, "H W 3"]:
        behind = torch.tensor(self._scene.background)
        return create_renderer("cpu")(gaussians, self._cameras.select([view]), background=behind)[0]


def _rows(g: Gaussians, rows: Tensor) -> Gaussians:
    return Gaussians(g.means[rows], g.quats[rows], g.scales[rows], g.opacities[rows], g.colors[rows])


def _with_gains(g: Gaussians, size: Float[Tensor, "G"], opacity: Float[Tensor, "G"]) -> Gaussians:
    return replace(g, scales=g.scales * size[:, None], opacities=(g.opacities * opacity).clamp(max=1))
