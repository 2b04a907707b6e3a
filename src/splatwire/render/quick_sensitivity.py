"""What anchors are worth in the picture, at a glance: a quarter of the time of `render_sensitivity`.

Each Gaussian's worth comes from drawing alone; through the networks go only the anchors that were worth most in the
first half of the views, and only what they cost together is kept: a single one's cost, from two views, is noise, and
those that look cheap by chance would be copied too coarsely (a sketch below `grow` on the bundled scene).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float64
from torch import Tensor

from splatwire.model import AnchorScene
from splatwire.model.compiled_heads import SpawnedGaussians, drawn_with_anchors
from splatwire.model.gaussian_heads import spawn_gaussians
from splatwire.model.tensors import to_tensors
from splatwire.render.backends import create_differentiable_renderer
from splatwire.render.sensitivity import Sensitivity
from splatwire.scene import Anchors, Cameras, Gaussians

_TYPICAL = 1 / 3
"""Of what errors cost per removal on the whole, what they cost of most anchors: a few have half of the sum. Of the
bundled scene a sketch is 0.3 dB better than with 1, and as good with 1/2 and 1/8."""
_FIELDS = ("means", "quats", "scales", "opacities", "colors")


def quick_sensitivity(
    scene: AnchorScene,
    cameras: Cameras,
    *,
    chosen: int,
    probes: int = 1,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Sensitivity:
    """Estimates sensitivities over a set of views, of those anchors that are worth most.

    Args:
        scene: The complete scene, without hints, on the CPU.
        cameras: Where it is looked at from; at least two views.
        chosen: Anchors that are told apart; the removal of all others is said to cost nothing.
        probes: Random sign patterns per view.
        seed: Of the signs.
        progress: Called with the share of views that is done.
    """
    scene = to_tensors(scene)
    a, draw, rng = scene.anchors, create_differentiable_renderer("cpu"), torch.Generator().manual_seed(seed)
    (num, count), width, first = a.mask.shape, a.features.shape[1] + a.scalings.shape[1], cameras.num_views // 2
    removal, offsets = (torch.zeros(size, dtype=torch.float64) for size in ((num,), (num, count)))
    rows, parts = torch.empty(0, dtype=torch.int64), list[_Through]()
    for view in range(cameras.num_views):
        if view == first:
            rows = removal.argsort(descending=True, stable=True)[:chosen].sort().values
        seen = to_tensors(drawn_with_anchors(scene, cameras, view))
        leaves = [getattr(seen.gaussians, name).requires_grad_() for name in _FIELDS]
        picture = draw(Gaussians(*leaves), cameras.select([view]), background=torch.tensor(scene.background))[0]
        place = seen.anchor_index * count + seen.offset_index
        for probe in range(probes):
            signs = (torch.randint(0, 2, picture.shape, generator=rng) * 2 - 1).to(picture)
            found = torch.autograd.grad((picture * signs).sum(), leaves, retain_graph=probe < probes - 1)
            present = (found[3] * leaves[3].detach()).double()
            each = torch.zeros(num * count, dtype=torch.float64).index_add_(0, place, present).view(num, count)
            removal += each.sum(dim=1) ** 2 / probes
            offsets += each**2 / probes
            if len(rows) and not probe:
                parts.append(_through(scene, cameras, view, rows, (seen, found), each[rows]))
        if progress:
            progress((view + 1) / cameras.num_views)
    scale = 1 / (cameras.num_views * cameras.width * cameras.height * 3)
    kept = torch.zeros(num, dtype=torch.bool).index_fill_(0, rows, value=True)
    return _shared(removal * kept * scale, offsets * scale, _relative_size(a), parts, width)


@dataclass(frozen=True, eq=False)
class _Through:
    """Squared errors of a view, summed over the chosen anchors.

    Attributes:
        metric: Of features and logarithms of scalings, (D, D).
        offset: Of a coordinate of an offset, and
        offset_share: what `_shared` expects of it, but for a factor.
        removal: Of leaving them out.
    """

    metric: Float64[Tensor, "D D"]
    offset: float
    offset_share: float
    removal: float


def _through(
    scene: AnchorScene,
    cameras: Cameras,
    view: int,
    rows: Tensor,
    drawn: tuple[SpawnedGaussians, tuple[Tensor, ...]],
    each: Float64[Tensor, "R K"],
) -> _Through:
    """Follows the gradients of a view's Gaussians through the networks, of the anchors `rows` alone."""
    a, (seen, gradients), count = scene.anchors, drawn, scene.anchors.mask.shape[1]
    inputs = [t[rows].clone().requires_grad_() for t in (a.features, a.scalings, a.offsets)]
    own = Anchors(a.positions[rows], inputs[0], inputs[1], inputs[2], a.mask[rows])
    everything = torch.ones(len(rows), dtype=torch.bool)
    again = spawn_gaussians(own, scene.heads, torch.as_tensor(cameras.centers[view]).to(a.positions), everything)
    place = torch.full((a.num_anchors * count,), -1, dtype=torch.int64)
    place[seen.anchor_index * count + seen.offset_index] = torch.arange(len(seen.anchor_index))
    place = place[rows[again.anchor_index] * count + again.offset_index]
    there = place >= 0  # not: those out of view or too faint to be drawn
    upstream = [torch.zeros(len(place), *g.shape[1:]).index_put((there,), g[place[there]]) for g in gradients]
    outputs = [getattr(again.gaussians, name) for name in _FIELDS]
    features, scalings, offsets = (g.double() for g in torch.autograd.grad(outputs, inputs, upstream))
    channels = torch.cat([features, scalings * a.scalings[rows]], dim=1)
    share = float((each**2 * _relative_size(own)[:, None]).sum())
    return _Through(channels.T @ channels, float((offsets**2).mean(dim=2).sum()), share, float((each**2).sum()))


def _relative_size(anchors: Anchors) -> Float64[Tensor, "N"]:
    """How much farther than its Gaussians are large an anchor's unit of offsets moves them, squared."""
    scalings = anchors.scalings.detach().double().clamp(min=1e-9)
    return (scalings[:, :3].mean(dim=1) / scalings[:, 3:].mean(dim=1)) ** 2


def _shared(
    removal: Tensor, offset_removal: Tensor, relative: Tensor, parts: list[_Through], width: int
) -> Sensitivity:
    """Each anchor's part of what was summed, by what its removal costs."""
    metric = sum((part.metric for part in parts), torch.zeros(width, width, dtype=torch.float64))
    removed, expected = sum(part.removal for part in parts), sum(part.offset_share for part in parts)
    per_removal = _TYPICAL * metric.diagonal() / max(removed, 1e-30)
    per_offset = _TYPICAL * sum(part.offset for part in parts) / max(expected, 1e-30)
    return Sensitivity(
        removal=removal,
        offset_removal=offset_removal,
        channels=removal[:, None] * per_removal,
        offsets=offset_removal * relative[:, None] * per_offset,
        metric=metric * (float(removal.sum()) / max(removed, 1e-30)),
    )
