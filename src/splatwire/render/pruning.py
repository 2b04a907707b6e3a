"""Leaving out the elements that no view would miss.

A picture is affine in the opacity of every single Gaussian: its derivative says what happens when that one is left out.
Sums of squares over pixels are estimated with random signs: for signs e, the mean of `(e . J) ** 2` is `J . J`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from splatwire.errors import InvalidValueError
from splatwire.model.appearance import Scene, origin_of, spawned_gaussians
from splatwire.ops.twister import Twister
from splatwire.render.backends import gradient_source
from splatwire.render.importance import surrounding_cameras
from splatwire.render.render import iterate_views
from splatwire.scene import Cameras

COMPARED_VIEWS, COMPARED_SIZE = 7, 256
"""Views in which a thinned scene is compared with the whole one; their number is one with which none is fitted."""


@dataclass(frozen=True, eq=False)
class Thinned:
    """A scene without some of its elements.

    Attributes:
        scene: What is left.
        kept: Which elements of the whole scene these are, ascending.
        psnr: Decibels of its pictures against those of the whole scene, over views that chose nothing.
    """

    scene: Scene
    kept: np.ndarray
    psnr: float


def thinned(
    scene: Scene, share: float, cameras: Cameras | None = None, *, progress: Callable[[float], None] | None = None
) -> Thinned:
    """Keeps the elements that pictures would miss most.

    Args:
        scene: The whole scene.
        share: Share of its elements that stays, above 0 and at most 1.
        cameras: Where it is looked at from; None for views around it.
        progress: Called with the share of the work that is done.

    Raises:
        InvalidValueError: If the share is impossible, or leaves nothing.
    """
    if not 0 < share <= 1 or round(share * scene.num_elements) < 1:
        raise InvalidValueError(f"a share of {share:g} of {scene.num_elements:,} {scene.ELEMENTS} cannot be kept")
    seen_from = surrounding_cameras(scene) if cameras is None else cameras
    errors = removal_errors(scene, seen_from, progress=progress)
    kept = np.sort(np.argsort(-errors, kind="stable")[: round(share * scene.num_elements)])
    left = scene.select(kept)
    others = surrounding_cameras(scene, COMPARED_VIEWS, COMPARED_SIZE)
    pairs = zip(iterate_views(left, others), iterate_views(scene, others), strict=True)
    error = [float(((ours - whole).astype(np.float64) ** 2).mean()) for ours, whole in pairs]
    return Thinned(left, kept, sum(-10 * math.log10(max(e, 1e-10)) for e in error) / len(error))


def removal_errors(
    scene: Scene,
    cameras: Cameras,
    *,
    probes: int = 2,
    seed: int = 0,
    renderer: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Float64[np.ndarray, "N"]:
    """Estimates the mean squared error of pictures, to first order, if each element alone is left out.

    Args:
        scene: The complete scene.
        cameras: Where it is looked at from.
        probes: Random sign patterns per view.
        seed: Of the signs.
        renderer: Name of a differentiable renderer.
        progress: Called with the share of views that is done.
    """
    find, rng, total = gradient_source(renderer), Twister(seed), np.zeros(scene.num_elements)
    cameras = cameras.relative_to(origin_of(scene))
    behind = np.array(scene.background, np.float32)
    for view in range(cameras.num_views):
        spawned = spawned_gaussians(scene, cameras, view)
        opacities = spawned.gaussians.opacities
        slopes = np.zeros(len(opacities))

        def add(some: slice, *gradients: np.ndarray, slopes: np.ndarray = slopes, at: np.ndarray = opacities) -> None:
            slopes[some] = gradients[3].astype(np.float64) * at[some]

        def signs(
            shape: tuple[int, ...], slopes: np.ndarray = slopes, own: np.ndarray = spawned.anchor_index
        ) -> Iterator[np.ndarray]:
            for _ in range(probes):
                yield rng.signs(shape)
                total[:] += np.bincount(own, slopes, len(total)) ** 2

        find(spawned.gaussians, cameras.select([view]), signs, add, behind)
        if progress:
            progress((view + 1) / cameras.num_views)
    return total / max(probes * cameras.num_views * cameras.width * cameras.height * 3, 1)
