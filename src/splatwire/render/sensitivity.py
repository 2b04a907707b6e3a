"""Estimates how much the rendered pictures change if an anchor is removed or its attributes change."""

# The estimator is the one of `splatwire.render.pruning`: the squared gradient of the sum of all pixels, each multiplied
# by a random sign.

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from splatwire.anchors.head_gradients import Spawning, visible_anchors
from splatwire.ops.threads import one_blas_thread
from splatwire.ops.twister import Twister
from splatwire.render.cpu import each_gradient_cpu
from splatwire.types import AnchorScene, Cameras, Gaussians


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Estimated errors in the rendered pictures if anchors of a scene are removed or changed.

    All values are mean squared errors per pixel and channel. The error of changing an attribute grows with the square
    of the change.

    Attributes:
        removal: Error if an anchor is removed.
        offset_removal: Error if one Gaussian of an anchor is removed.
        channels: Error if a feature, or the logarithm of a scaling, changes by 1.
        offsets: Error if a coordinate of an offset changes by 1.
        metric: Matrix M for changes of several features and logarithms of scalings at the same time. If the values of
            each anchor change by the vector d, the error is `d . M d`, summed over all anchors.
    """

    # The diagonal of `metric` is the sum of `channels` over all anchors.

    removal: Float64[np.ndarray, "N"]
    offset_removal: Float64[np.ndarray, "N K"]
    channels: Float64[np.ndarray, "N D"]
    offsets: Float64[np.ndarray, "N K"]
    metric: Float64[np.ndarray, "D D"]


@one_blas_thread()  # sums must not depend on the number of processors
def render_sensitivity(
    scene: AnchorScene,
    cameras: Cameras,
    *,
    background: Float[np.ndarray, "3"] | None = None,
    probes: int = 2,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Sensitivity:
    """Estimates how much the pictures change if an anchor is removed or its attributes change.

    Args:
        scene: The complete scene.
        cameras: Views to render.
        background: RGB of the background; None for the scene's background.
        probes: Number of back-propagations per view; more give a more precise estimate of the errors of removals.
        seed: Random seed.
        progress: Called with the finished share of views, 0 to 1.
    """
    # Errors of changed attributes are estimated from one back-propagation.
    a, rng, cameras = scene.anchors, Twister(seed), cameras.relative_to(scene.origin)
    (num, count), width = a.mask.shape, a.features.shape[1] + a.scalings.shape[1]
    if background is None:
        background = np.array(scene.background, np.float32)
    sizes = ((num,), (num, count), (num, width), (num, count), (width, width))
    total = Sensitivity(*(np.zeros(size) for size in sizes))
    for view in range(cameras.num_views):
        rows = np.flatnonzero(visible_anchors(a, cameras, view))
        spawned = Spawning(a.select(rows), scene.heads, cameras.centers[view].astype(np.float32))
        gradients = GatheredGradients(spawned.gaussians)
        anchor = rows[spawned.anchor_index]

        def signs(
            shape: tuple[int, ...],
            rows: np.ndarray = rows,
            anchor: np.ndarray = anchor,
            spawned: Spawning = spawned,
            gradients: GatheredGradients = gradients,
        ) -> Iterator[np.ndarray]:
            for probe in range(probes):
                yield rng.signs(shape)
                _add_removal(total, anchor * count + spawned.offset_index, gradients.presence, probes)
                if not probe:
                    _add_changes(total, rows, a.scalings, spawned, gradients)

        each_gradient_cpu(spawned.gaussians, cameras.select([view]), signs, gradients.add, background)
        if progress:
            progress((view + 1) / cameras.num_views)
    scale = 1 / max(cameras.num_views * cameras.width * cameras.height * 3, 1)
    return Sensitivity(**{name: value * scale for name, value in vars(total).items()})


class GatheredGradients:
    """Buffer for the derivatives of one number, such as a weighted sum of all pixels of an image.

    The derivatives are with respect to the attributes of the Gaussians of the view. They are added in parts.

    Args:
        gaussians: The Gaussians of the view.

    Attributes:
        fields: Derivatives with respect to means, quats, scales, opacities and colors.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self._opacities = gaussians.opacities
        self.fields = [np.zeros(values.shape, np.float32) for values in vars(gaussians).values()]

    def add(self, rows: slice, *gradients: np.ndarray) -> None:
        """Stores the derivatives for a range of Gaussians.

        Args:
            rows: Range of the Gaussians.
            *gradients: Derivatives with respect to their means, quats, scales, opacities and colors.
        """
        for whole, part in zip(self.fields, gradients, strict=True):
            whole[rows] = part

    @property
    def presence(self) -> Float64[np.ndarray, "G"]:
        """For each Gaussian, decrease of the differentiated number if this Gaussian is removed, to first order."""
        # The derivative with respect to a factor on the Gaussian's opacity; the effect has the opposite sign.
        return (self.fields[3] * self._opacities).astype(np.float64)


def _add_removal(total: Sensitivity, indices: np.ndarray, presence: np.ndarray, probes: int) -> None:
    """Adds to `total` the picture errors that removals would cause in one view.

    Errors are estimated for the removal of each anchor, and for the removal of each single Gaussian. A probe is the sum
    of all pixel values, each multiplied by a random sign. The squared change of a probe estimates the picture error.

    Args:
        total: Errors summed over views; changed in place.
        indices: Index of each Gaussian among all N * K possible Gaussians of the scene, int64 (G).
        presence: For each Gaussian, estimated decrease of the probe if this Gaussian is removed, float64 (G).
        probes: Number of probes per view. This function is called once for each probe. It divides the errors by
            `probes`, so that the calls add up to a mean.
    """
    # Errors are estimated from gradients of one sum of all pixels, each with a random sign, and averaged over the
    # probes.
    shape = total.offset_removal.shape
    each = np.bincount(indices, presence, shape[0] * shape[1]).reshape(shape)
    total.removal[:] += each.sum(axis=1) ** 2 / probes
    total.offset_removal[:] += each**2 / probes


def _add_changes(
    total: Sensitivity, rows: np.ndarray, scalings: np.ndarray, spawned: Spawning, gradients: GatheredGradients
) -> None:
    """Adds to `total` the picture errors that changes of features, scalings and offsets would cause in one view.

    Args:
        total: Errors summed over views; changed in place.
        rows: Indices of the anchors in view, int64 (n).
        scalings: Scalings of all anchors, (N, 6).
        spawned: Gaussians of the anchors in view.
        gradients: Gradients of the probe (the sum of all pixel values, each multiplied by a random sign) with respect
            to the Gaussians `spawned`.
    """
    # The gradients are back-propagated to the anchors, through the networks that generate the Gaussians.
    back = spawned.gradients(gradients.fields)
    channels = np.concatenate([back.features, back.scalings * scalings[rows]], axis=1).astype(np.float64)
    total.channels[rows] += channels**2
    total.offsets[rows] += (back.offsets.astype(np.float64) ** 2).mean(axis=2)
    total.metric[:] += channels.T @ channels
