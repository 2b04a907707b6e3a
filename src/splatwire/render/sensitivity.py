"""What each anchor, and each part of it, is worth in the picture: squared error per pixel if it changes.

A picture is affine in the opacity of every single Gaussian: its derivative says what happens when that one is left out.
Sums of squares over pixels are estimated with random signs: for signs e, the mean of `(e . J) ** 2` is `J . J`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from splatwire.model import AnchorScene
from splatwire.model.gaussian_heads import spawn_gaussians, visible_anchors
from splatwire.model.tensors import to_tensors
from splatwire.render.backends import create_differentiable_renderer
from splatwire.scene import Cameras


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Mean squared error per pixel and channel, to first order, of changing one thing alone.

    Attributes:
        removal: If an anchor is left out.
        offset_removal: If one of its Gaussians is left out.
        channels: Per squared change of a feature, or of the logarithm of a scaling.
        offsets: Per squared change of each coordinate of an offset.
        metric: `channels` as a full matrix, summed over all anchors.
    """

    removal: Float64[Any, "N"]
    offset_removal: Float64[Any, "N K"]
    channels: Float64[Any, "N D"]
    offsets: Float64[Any, "N K"]
    metric: Float64[Any, "D D"]


def render_sensitivity(
    scene: AnchorScene,
    cameras: Cameras,
    *,
    background: Float[Tensor, "3"] | None = None,
    probes: int = 2,
    seed: int = 0,
    renderer: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Sensitivity:
    """Estimates sensitivities over a set of views.

    Args:
        scene: The complete scene.
        cameras: Where it is looked at from.
        background: RGB behind everything; the scene's own where absent.
        probes: Random sign patterns per view that tell what is worth most if it is left out; all else, which goes
            through the networks and decides less, follows from the first.
        seed: Of the signs.
        renderer: Name of a differentiable renderer.
        progress: Called with the share of views that is done.
    """
    scene = to_tensors(scene)
    a, draw, rng = scene.anchors, create_differentiable_renderer(renderer), torch.Generator().manual_seed(seed)
    num, count, width = a.num_anchors, a.mask.shape[1], a.features.shape[1] + a.scalings.shape[1]
    behind = torch.tensor(scene.background) if background is None else background
    sizes = ((num,), (num, count), (num, width), (num, count), (width, width))
    total = Sensitivity(*(torch.zeros(size, dtype=torch.float64) for size in sizes))
    for view in range(cameras.num_views):
        inputs = [t.detach().clone().requires_grad_() for t in (a.features, a.scalings, a.offsets)]
        moved = replace(a, features=inputs[0], scalings=inputs[1], offsets=inputs[2])
        spawned = spawn_gaussians(
            moved,
            scene.heads,
            torch.as_tensor(cameras.centers[view]).to(a.positions),
            visible_anchors(a, cameras, view),
        )
        presence = torch.ones_like(spawned.gaussians.opacities, requires_grad=True)
        gaussians = replace(spawned.gaussians, opacities=spawned.gaussians.opacities * presence)
        picture = draw(gaussians, cameras.select([view]), background=behind)[0]
        place = spawned.anchor_index * count + spawned.offset_index
        for probe in range(probes):
            signs = (torch.randint(0, 2, picture.shape, generator=rng) * 2 - 1).to(picture)
            wanted, again = [presence] if probe else [presence, *inputs], probe < probes - 1
            present, *others = (
                g.double() for g in torch.autograd.grad((picture * signs).sum(), wanted, retain_graph=again)
            )
            each = torch.zeros(num * count, dtype=torch.float64).index_add_(0, place, present).view(num, count)
            total.removal.add_(each.sum(dim=1) ** 2 / probes)
            total.offset_removal.add_(each**2 / probes)
            if others:
                features, scalings, offsets = others
                rows = torch.cat([features, scalings * a.scalings], dim=1)
                total.channels.add_(rows**2)
                total.offsets.add_((offsets**2).mean(dim=2))
                total.metric.add_(rows.T @ rows)
        if progress:
            progress((view + 1) / cameras.num_views)
    scale = 1 / max(cameras.num_views * cameras.width * cameras.height * 3, 1)
    return Sensitivity(**{name: value * scale for name, value in vars(total).items()})
