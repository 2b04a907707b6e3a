"""What the network sees of a received anchor: ratios only, so that neither units nor the meaning of features matter."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.conceal.scene_free.surroundings import CLOSE, Neighborhood, Surroundings
from splatwire.model import AnchorScene, Partial, Prior
from splatwire.scene.anchors import MIN_SIZE

SIGNATURE = 26
"""Entries of a signature."""
_COUNTS = (4, 12, 32)
_REACHES = (1.0, 4.0, 16.0)
"""Squared widths of the kernels that say how far an anchor covers, in units of the sizes of both."""
_MIDDLE_REACH = 4.0
_SPACING_RANK = 5
_MOST_LOST = 0.97


def signatures(partial: Partial[AnchorScene], around: Surroundings) -> Float[Tensor, "M signature"]:
    """Describes received anchors by what a receiver knows.

    The entries: losses of the whole scene, of the nearest 4, 12 and 32, of the area that neighbours of three reaches
    and of the two size classes cover; sizes against spacing and neighbours; active offsets; uncertainty of the prior.
    Shares `rho` are given as `-log(1 - rho)`, the logarithm of the area gain that would make up for them.

    Args:
        partial: What arrived.
        around: Surroundings of the anchors to describe, all of them received.
    """
    lost = (~partial.known).to(around.log_size.dtype)
    area = (2 * around.log_size).exp()
    floor = float(around.log_size.min().exp()) if len(lost) else MIN_SIZE
    sizes = partial.scene.anchors.scalings[around.rows].clamp(min=floor).log()
    own = sizes[:, 3:].mean(dim=1)
    overall = lost.mean() if len(lost) else lost.sum()
    columns = [_gain_for(overall).expand_as(own)]
    columns += _losses_nearby(lost, area, own, around)
    for members in around.classes:
        columns += _losses_in_class(lost, area, own, around.rows, members)
    columns += _sizes(sizes, own, around)
    columns += _shape(partial, around, own, lost)
    return torch.stack(columns, dim=1)


def near_losses(partial: Partial[AnchorScene], around: Surroundings) -> Float[Tensor, "M"]:
    """Share of what is lost among all the neighbours, weighted as in `Grow`; 0 for an anchor without any."""
    near, weight = around.near.index, around.weights
    lost = (weight * ~partial.known)[near].sum(dim=1)
    tiny = torch.finfo(weight.dtype).tiny
    return (lost / weight[near].sum(dim=1).clamp(min=tiny)).to(around.log_size.dtype)


def _gain_for(share: Tensor) -> Tensor:
    return -torch.log1p(-share.clamp(max=_MOST_LOST))


def _mean(values: Float[Tensor, "M k"]) -> Float[Tensor, "M"]:
    return values.sum(dim=1) / max(values.shape[1], 1)


def _spread_of(area: Tensor, rows: Tensor, near: Neighborhood) -> tuple[Float[Tensor, "M k"], Float[Tensor, "M k"]]:
    """Areas of the neighbours, and their squared distances in units of both sizes."""
    theirs = area[near.index]
    return theirs, near.distance**2 / (2 * (theirs + area[rows, None]))


def _losses_nearby(lost: Tensor, area: Tensor, own: Tensor, around: Surroundings) -> list[Float[Tensor, "M"]]:
    rows, near, tiny = around.rows, around.near.first(CLOSE), torch.finfo(area.dtype).tiny
    there = lost[near.index]
    columns = [_gain_for(_mean(there[:, :count])) for count in _COUNTS]
    theirs, far = _spread_of(area, rows, near)
    for reach in _REACHES:
        weight = theirs * torch.exp(far / -reach)
        gone = (weight * there).sum(dim=1)
        columns.append(_gain_for(gone / (weight.sum(dim=1) + area[rows]).clamp(min=tiny)))
        if reach == _MIDDLE_REACH:
            columns.append(torch.log1p(gone / (2 * own).exp()))
    columns.append(_gain_for((theirs * there).sum(dim=1) / theirs.sum(dim=1).clamp(min=tiny)))
    return columns


def _losses_in_class(
    lost: Tensor, area: Tensor, own: Tensor, rows: Tensor, members: Neighborhood
) -> list[Float[Tensor, "M"]]:
    there = lost[members.index]
    theirs, far = _spread_of(area, rows, members)
    weight = theirs * torch.exp(far / -_MIDDLE_REACH)
    gone = (weight * there).sum(dim=1)
    whole = (weight.sum(dim=1) + area[rows]).clamp(min=torch.finfo(area.dtype).tiny)
    return [_gain_for(_mean(there)), _gain_for(gone / whole), torch.log1p(gone / (2 * own).exp())]


def _sizes(sizes: Float[Tensor, "M 6"], own: Tensor, around: Surroundings) -> list[Float[Tensor, "M"]]:
    distance, expected = around.near.first(CLOSE).distance, around.log_size[around.rows]
    if distance.shape[1] == 0:
        distance = expected.exp()[:, None]  # a lonely anchor: its own size is the only length there is
    spacing = distance[:, min(_SPACING_RANK, distance.shape[1] - 1)].clamp(min=MIN_SIZE).log()
    typical = around.log_size.median() if len(around.log_size) else around.log_size.sum()
    return [
        own - spacing,
        sizes[:, :3].mean(dim=1) - spacing,
        sizes[:, 3:].amax(dim=1) - own,
        expected - spacing,
        expected - typical,
        distance[:, -1].clamp(min=MIN_SIZE).log() - spacing,
    ]


def _shape(partial: Partial[AnchorScene], around: Surroundings, own: Tensor, lost: Tensor) -> list[Float[Tensor, "M"]]:
    """Active offsets, here and around; how far the size is from its prediction; how unsure the prior is."""
    anchors, prior, rows, near = partial.scene.anchors, partial[Prior], around.rows, around.near.first(CLOSE).index
    active = anchors.mask.sum(dim=1).to(own.dtype) * (1 - lost)
    typical = active[near].sum(dim=1) / (1 - lost)[near].sum(dim=1).clamp(min=1)
    arrived = anchors.features[partial.known]
    spread = arrived.std(dim=0, correction=0) if len(arrived) else torch.ones(anchors.features.shape[1])
    scaling = prior.scaling
    unsure = scaling.scale[rows].mean(dim=1) / scaling.mean[rows].abs().mean(dim=1).clamp(min=MIN_SIZE)
    return [
        active[rows].clamp(min=0.5).log(),
        typical.clamp(min=0.5).log(),
        own - around.log_size[rows],
        (prior.feature.scale[rows] @ (1 / spread.clamp(min=1e-6)) / len(spread)).clamp(min=1e-3, max=1e3).log(),
        unsure.clamp(min=1e-4, max=1e3).log(),
    ]
