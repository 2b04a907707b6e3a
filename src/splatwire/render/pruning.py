"""Pruning: removal of the elements with the least effect on images.

The image error of a removal is estimated from gradients with respect to the opacity.
"""

# Removing a Gaussian sets its opacity to 0. An image is an affine function of the opacity of each single Gaussian, so
# the effect of the removal follows from the gradient. The squared error is the sum of the squared gradients of all
# pixels. To compute it exactly would take one back-propagation per pixel. It is estimated from the sum of all pixels,
# each multiplied by a random sign (-1 or 1). The gradient of this sum takes one back-propagation; the expected value of
# its square is the squared error.

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from splatwire.anchors.appearance import as_scene, origin_of, spawned_gaussians
from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.ops.twister import Twister
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.importance import surrounding_cameras
from splatwire.render.render import iterate_views
from splatwire.types import Cameras
from splatwire.types.scene import Scene

COMPARED_VIEWS, COMPARED_SIZE = 7, 256
"""Number of views in which a pruned scene is compared with the full scene, and their width and height in pixels. The
number differs from that of the views used for pruning, so that the views differ too."""


@dataclass(frozen=True, eq=False)
class PrunedScene:
    """Result of pruning a scene.

    Attributes:
        scene: The remaining scene.
        kept: Indices of the remaining elements in the full scene, ascending.
        psnr: PSNR of images of the pruned scene, with images of the full scene as references, decibels.
    """

    # The PSNR is the mean over views that were not used for pruning.

    scene: Scene
    kept: np.ndarray
    psnr: float


@checked
def prune(
    scene: Scene, share: float, cameras: Cameras | None = None, *, progress: Callable[[float], None] | None = None
) -> PrunedScene:
    """Removes the elements of a scene with the smallest effect on images.

    Args:
        scene: The full scene.
        share: Share of the elements to keep, above 0 and at most 1.
        cameras: Cameras; None for views around the scene.
        progress: Called with the finished fraction of the work, 0 to 1.

    Raises:
        InvalidValueError: If an argument has another type, or the share is out of range or leaves nothing.
    """
    scene = as_scene(scene)
    if not 0 < share <= 1 or round(share * scene.num_elements) < 1:
        raise InvalidValueError(f"a share of {share:g} of {scene.num_elements:,} {scene.ELEMENTS} cannot be kept")
    seen_from = surrounding_cameras(scene) if cameras is None else cameras
    errors = removal_errors(scene, seen_from, progress=progress)
    kept = np.sort(np.argsort(-errors, kind="stable")[: round(share * scene.num_elements)])
    pruned = scene.select(kept)
    others = surrounding_cameras(scene, COMPARED_VIEWS, COMPARED_SIZE)
    pairs = zip(iterate_views(pruned, others), iterate_views(scene, others), strict=True)
    error = [float(((ours - whole).astype(np.float64) ** 2).mean()) for ours, whole in pairs]
    return PrunedScene(pruned, kept, sum(-10 * math.log10(max(e, 1e-10)) for e in error) / len(error))


def removal_errors(
    scene: Scene,
    cameras: Cameras,
    *,
    probes: int = 2,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Float64[np.ndarray, "N"]:
    """Estimates the mean squared image error caused by removing each element, to first order.

    Args:
        scene: The complete scene.
        cameras: Cameras of the images.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.
        progress: Called with the finished share of views.
    """
    rng, total = Twister(seed), np.zeros(scene.num_elements)
    cameras = cameras.relative_to(origin_of(scene))
    background = np.array(scene.background, np.float32)
    for view in range(cameras.num_views):
        spawned = spawned_gaussians(scene, cameras, view)
        opacities = spawned.gaussians.opacities
        slopes = np.zeros(len(opacities))

        def add(rows: slice, *gradients: np.ndarray, slopes: np.ndarray = slopes, at: np.ndarray = opacities) -> None:
            slopes[rows] = gradients[3].astype(np.float64) * at[rows]

        def signs(
            shape: tuple[int, ...], slopes: np.ndarray = slopes, rows: np.ndarray = spawned.anchor_index
        ) -> Iterator[np.ndarray]:
            for _ in range(probes):
                yield rng.signs(shape)
                total[:] += np.bincount(rows, slopes, len(total)) ** 2

        each_gradient_cpu(spawned.gaussians, cameras.select([view]), signs, add, background)
        if progress:
            progress((view + 1) / cameras.num_views)
    return total / max(probes * cameras.num_views * cameras.width * cameras.height * 3, 1)
