"""Where fine Gaussians are lost, the coarser level that stands for them is drawn in their place."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.conceal.base import Concealed, Concealer, check_at_least
from splatwire.conceal.registry import create_concealer, register_concealer
from splatwire.model import Partial
from splatwire.model.level_scene import Levels
from splatwire.ops.knn import NeighborTree
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

_NEAREST = 4
_APART, _ALIKE = 0.5, 0.25
"""A Gaussian and its copy: how far apart at most, in sizes of the copy, and how different at most, in logarithms of
what they cover."""
_SLACK = 0.2
"""What is missing of a merged Gaussian is known so badly: the finer ones nearest to it need not be those it stands
for."""


@register_concealer("coarse", needs=(Levels,))
@dataclass(frozen=True)
class Coarse:
    """Draws what the next coarser level has of lost Gaussians; those that arrived grow a little.

    A coarser Gaussian that is a copy is drawn if its original did not arrive. One that was merged from several is drawn
    as opaque as the share that is missing of what it covers: finer Gaussians count for the merged one that is nearest.

    Attributes:
        exponent: Of the growth of what arrived, see `Grow`.
        trust: How opaque a merged one is at most, as a multiple of the share that is lost of the finest level.
    """

    exponent: float = 0.35
    trust: float = 1.5

    def __post_init__(self) -> None:
        check_at_least("exponent of the gain", self.exponent, 0)
        check_at_least("trust in merged Gaussians", self.trust, 0)

    @property
    def name(self) -> str:
        """`coarse`."""
        return "coarse"

    def __call__(self, partial: Partial) -> Concealed:
        """See `Concealer`."""
        levels, known = partial[Levels], partial.known
        finest = levels.of == 0
        fine, coarse = (finest & known).nonzero()[:, 0], ((levels.of == 1) & known).nonzero()[:, 0]
        size, gain, left_out = _grown(create_concealer("grow", exponent=self.exponent), partial, finest)
        if len(coarse):
            lost = 1 - len(fine) / max(int(finest.sum()), 1)
            copied = levels.copied[coarse]
            gain[coarse] = _missing(partial.elements, fine, coarse, copied, min(1.0, self.trust * lost))
            left_out[coarse] = gain[coarse] <= 0
        return Concealed(size, left_out, gain, shows=True)


def _grown(grow: Concealer, partial: Partial, finest: Bool[Tensor, "N"]) -> tuple[Tensor, Tensor, Tensor]:
    """Gains of size and opacity that `grow` gives the finest level, and what it leaves out, as all coarser levels."""
    chosen, count = finest.nonzero()[:, 0], len(finest)
    erasures = Erasures(partial.erasures.received[chosen])
    own = grow(replace(partial, scene=partial.scene.select(chosen), erasures=erasures, said=()))
    size, gain, left_out = torch.ones(count), torch.ones(count), torch.ones(count, dtype=torch.bool)
    size[chosen], left_out[chosen] = own.size_gain, own.left_out
    gain[chosen] = torch.ones(len(chosen)) if own.opacity_gain is None else own.opacity_gain
    return size, gain, left_out


def _missing(
    splats: Splats, fine: Tensor, coarse: Tensor, copied: Bool[Tensor, "C"], trust: float
) -> Float[Tensor, "C"]:
    """Share of each coarser Gaussian that is missing among those finer ones that arrived."""
    covers = _covers(splats)
    shown = torch.ones(len(coarse))
    if not len(fine):
        return shown
    original = _originals(splats, covers, fine, coarse[copied])
    shown[copied.nonzero()[:, 0][original >= 0]] = 0
    merged = (~copied).nonzero()[:, 0]
    rest = torch.ones(len(fine), dtype=torch.bool)
    rest[original[original >= 0]] = False
    if not len(merged):
        return shown
    nearest, _ = NeighborTree(splats.means[coarse[merged]]).query(splats.means[fine[rest]], 1)
    there = torch.zeros(len(merged), dtype=torch.float64).index_add_(0, nearest[:, 0], covers[fine[rest]])
    missing = 1 - there / covers[coarse[merged]].clamp(min=1e-300)
    shown[merged] = (((missing - _SLACK) / (1 - _SLACK)).clamp(0, 1) * trust).float()
    return shown


def _originals(splats: Splats, covers: Float[Tensor, "N"], fine: Tensor, copies: Tensor) -> Tensor:
    """Which of the finer Gaussians each copy is of, an index into `fine`; -1 where it did not arrive."""
    near, distance = NeighborTree(splats.means[fine]).query(splats.means[copies], _NEAREST)
    size = splats.scales[copies].sort(dim=1).values[:, 1:2]
    unlike = (covers[fine][near] / covers[copies][:, None].clamp(min=1e-300)).clamp(min=1e-300).log().abs()
    fits = (distance <= _APART * size) & (unlike <= _ALIKE)
    best = torch.where(fits, unlike, torch.full_like(unlike, torch.inf)).min(dim=1).indices
    return torch.where(fits.any(dim=1), near.gather(1, best[:, None])[:, 0], torch.full_like(best, -1))


def _covers(splats: Splats) -> Float[Tensor, "N"]:
    """What each covers from its broad side, times its opacity; square world units."""
    ordered = splats.scales.double().sort(dim=1).values
    return splats.opacities.double() * ordered[:, 1] * ordered[:, 2]
