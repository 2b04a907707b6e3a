"""Leaving out the elements that no view would miss.

A picture is affine in the opacity of every single Gaussian: its derivative says what happens when that one is left out.
Sums of squares over pixels are estimated with random signs: for signs e, the mean of `(e . J) ** 2` is `J . J`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float64
from torch import Tensor

from splatwire.errors import InvalidValueError
from splatwire.model.appearance import Scene, origin_of, spawned_gaussians
from splatwire.render.backends import create_renderer
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
    kept: Tensor
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
    best = errors.argsort(descending=True, stable=True)[: round(share * scene.num_elements)]
    kept = best.sort().values
    left = scene.select(kept)
    others = surrounding_cameras(scene, COMPARED_VIEWS, COMPARED_SIZE)
    pairs = zip(iterate_views(left, others), iterate_views(scene, others), strict=True)
    error = [float((ours - whole).double().square().mean()) for ours, whole in pairs]
    return Thinned(left, kept, sum(-10 * math.log10(max(e, 1e-10)) for e in error) / len(error))


def removal_errors(
    scene: Scene,
    cameras: Cameras,
    *,
    probes: int = 2,
    seed: int = 0,
    renderer: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Float64[Tensor, "N"]:
    """Estimates the mean squared error of pictures, to first order, if each element alone is left out.

    Args:
        scene: The complete scene.
        cameras: Where it is looked at from.
        probes: Random sign patterns per view.
        seed: Of the signs.
        renderer: Name of a differentiable renderer.
        progress: Called with the share of views that is done.
    """
    draw, rng = create_renderer(renderer), torch.Generator().manual_seed(seed)
    cameras = cameras.relative_to(origin_of(scene))
    behind, total = torch.tensor(scene.background), torch.zeros(scene.num_elements, dtype=torch.float64)
    for view in range(cameras.num_views):
        with torch.no_grad():
            spawned = spawned_gaussians(scene, cameras, view)
        presence = torch.ones_like(spawned.gaussians.opacities, requires_grad=True)
        gaussians = replace(spawned.gaussians, opacities=spawned.gaussians.opacities * presence)
        picture = draw(gaussians, cameras.select([view]), background=behind)[0]
        for probe in range(probes):
            signs = (torch.randint(0, 2, picture.shape, generator=rng) * 2 - 1).to(picture)
            (gradient,) = torch.autograd.grad((picture * signs).sum(), presence, retain_graph=probe < probes - 1)
            each = torch.zeros_like(total).index_add_(0, spawned.anchor_index, gradient.double())
            total += each**2
        if progress:
            progress((view + 1) / cameras.num_views)
    return total / max(probes * cameras.num_views * cameras.width * cameras.height * 3, 1)
