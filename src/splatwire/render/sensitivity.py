"""Sensitivity of images to anchors and their attributes: mean squared image error caused by a change of an anchor.

An image is affine in the opacity of each single Gaussian. Its derivative by the opacity therefore gives the effect of
removing the Gaussian. Let J be the derivatives of all pixel values by one parameter. The sum of their squares, `J . J`,
is the mean of `(e . J) ** 2` over images e of random signs, -1 or 1. One back-propagation of e gives `e . J` for all
parameters at once.
"""

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
    """Mean squared image error per pixel and channel caused by single changes of a scene, to first order.

    Attributes:
        removal: Error when an anchor is removed.
        offset_removal: Error when one Gaussian of an anchor is removed.
        channels: Error per squared change of a feature, or of the logarithm of a scaling.
        offsets: Error per squared change of each coordinate of an offset.
        metric: Matrix M for changes of several features and logarithms of scalings at once: `d . M d` is the error of
            changing the values of an anchor by d, summed over all anchors. The diagonal is the sum of `channels` over
            all anchors.
    """

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
    """Estimates the sensitivity of images to every anchor over a set of views.

    Args:
        scene: The complete scene.
        cameras: Cameras.
        background: RGB of the background; None for that of the scene.
        probes: Number of random sign images per view for the errors of removing anchors and Gaussians. All other errors
            are estimated from the first image, because they need less precision and a back-propagation through the
            networks.
        seed: Seed of the signs.
        progress: Called with the finished share of views.
    """
    a, rng = scene.anchors, Twister(seed)
    (num, count), width = a.mask.shape, a.features.shape[1] + a.scalings.shape[1]
    behind = np.array(scene.background, np.float32) if background is None else background
    sizes = ((num,), (num, count), (num, width), (num, count), (width, width))
    total = Sensitivity(*(np.zeros(size) for size in sizes))
    for view in range(cameras.num_views):
        rows = np.flatnonzero(visible_anchors(a, cameras, view))
        spawned = Spawning(a.select(rows), scene.heads, cameras.centers[view].astype(np.float32))
        found = GatheredGradients(spawned.gaussians)
        anchor = rows[spawned.anchor_index]

        def signs(
            shape: tuple[int, ...],
            rows: np.ndarray = rows,
            anchor: np.ndarray = anchor,
            spawned: Spawning = spawned,
            found: GatheredGradients = found,
        ) -> Iterator[np.ndarray]:
            for probe in range(probes):
                yield rng.signs(shape)
                _add_removal(total, anchor * count + spawned.offset_index, found.presence, probes)
                if not probe:
                    _add_changes(total, rows, a.scalings, spawned, found)

        each_gradient_cpu(spawned.gaussians, cameras.select([view]), signs, found.add, behind)
        if progress:
            progress((view + 1) / cameras.num_views)
    scale = 1 / max(cameras.num_views * cameras.width * cameras.height * 3, 1)
    return Sensitivity(**{name: value * scale for name, value in vars(total).items()})


class GatheredGradients:
    """Gradients of a view's Gaussians, collected from slices of the Gaussians.

    Args:
        gaussians: The Gaussians.

    Attributes:
        fields: Gradients of means, quats, scales, opacities and colors.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self._opacities = gaussians.opacities
        self.fields = [np.zeros(values.shape, np.float32) for values in vars(gaussians).values()]

    def add(self, some: slice, *gradients: np.ndarray) -> None:
        """Stores the gradients of a range of Gaussians (slice `some`); the gradients are in the order of `fields`."""
        for whole, part in zip(self.fields, gradients, strict=True):
            whole[some] = part

    @property
    def presence(self) -> Float64[np.ndarray, "G"]:
        """Gradient with respect to a factor on the opacity of each Gaussian, at factor 1.

        Factor 0 would remove the Gaussian, so the gradient estimates the effect of removing it.
        """
        return (self.fields[3] * self._opacities).astype(np.float64)


def _add_removal(total: Sensitivity, place: np.ndarray, presence: np.ndarray, probes: int) -> None:
    """Estimates the errors of removing anchors and single Gaussians from one random sign image, and adds them.

    Args:
        total: Errors summed over views; changed in place.
        place: Index of each Gaussian's anchor times K, plus its index within the anchor, int64 (G).
        presence: Estimated effect of removing each Gaussian (`GatheredGradients.presence`), float64 (G).
        probes: Number of random sign images per view, by which the estimate is divided.
    """
    shape = total.offset_removal.shape
    each = np.bincount(place, presence, shape[0] * shape[1]).reshape(shape)
    total.removal[:] += each.sum(axis=1) ** 2 / probes
    total.offset_removal[:] += each**2 / probes


def _add_changes(
    total: Sensitivity, rows: np.ndarray, scalings: np.ndarray, spawned: Spawning, found: GatheredGradients
) -> None:
    """Estimates the errors of changing features, scalings and offsets from one random sign image, and adds them.

    Args:
        total: Errors summed over views; changed in place.
        rows: Indices of the anchors in view, int64 (n).
        scalings: Scalings of all anchors, (N, 6).
        spawned: Gaussians of the anchors in view.
        found: Gradients of these Gaussians.
    """
    back = spawned.gradients(found.fields)
    channels = np.concatenate([back.features, back.scalings * scalings[rows]], axis=1).astype(np.float64)
    total.channels[rows] += channels**2
    total.offsets[rows] += (back.offsets.astype(np.float64) ** 2).mean(axis=2)
    total.metric[:] += channels.T @ channels
