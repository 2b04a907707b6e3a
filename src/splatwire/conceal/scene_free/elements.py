"""The network for explicit Gaussians: what it sees of a received one, and the gains that it makes of it.

Where a share `rho` of the Gaussians around one is lost, `L = -log(1 - rho)`. A size gain of `exp(L / 2)` keeps the area
that surfaces cover, an opacity `1 - (1 - a) ** exp(L)` the light that passes through many thin layers: which of the two
a place needs depends on how its Gaussians overlap, and the network says so.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.conceal.base import Concealed
from splatwire.conceal.scene_free.network import HIDDEN, Perceptron
from splatwire.model import Partial, SplatScene
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.scene.anchors import MIN_SIZE

ELEMENT_SIGNATURE = 12
"""Entries of what the network sees."""
_NEIGHBORS, _CLOSE, _SPACING_RANK = 64, 32, 6
_MOST_LOST = 0.97
BASE = (0.15, 0.75)
"""Exponents of `exp(L)` before the network changes them, of size and of opacity."""
_SIZES, _POWERS = (-0.5, 1.0), (-0.5, 2.5)
"""Least and largest exponents."""
_OPACITIES = (1e-4, 1 - 1e-4)


@dataclass(frozen=True, eq=False)
class ElementInputs:
    """All that the network needs of one loss of one scene.

    Attributes:
        rows: The received Gaussians.
        signature: What is known of them and their surroundings: ratios only, no unit of length.
        lost: `L` of the surroundings of each.
        opacity: Their opacities.
    """

    rows: Int64[Tensor, "M"]
    signature: Float[Tensor, "M D"]
    lost: Float[Tensor, "M"]
    opacity: Float[Tensor, "M"]


def element_inputs(partial: Partial[SplatScene]) -> ElementInputs:
    """Looks at the surroundings of every received Gaussian."""
    splats, known = partial.scene.splats, partial.known
    rows, opacities, log_axes = known.nonzero()[:, 0], splats.opacities, splats.log_axes
    log_sizes = log_axes.mean(dim=1)
    near, distance = nearest_others(NeighborTree(splats.means), splats.means[rows], rows, _NEIGHBORS)
    gone = (~known).to(distance.dtype)
    size, area = log_sizes.exp(), (2 * log_sizes).exp()
    tiny = torch.finfo(size.dtype).tiny
    lost = _gain_for((gone * size)[near].sum(dim=1) / size[near].sum(dim=1).clamp(min=tiny))
    close, far = near[:, :_CLOSE], distance[:, :_CLOSE]
    there = 1 - gone[close]
    reach = (far / area[close].add(area[rows, None]).sqrt().clamp(min=MIN_SIZE)) ** 2
    logit = torch.logit(opacities.clamp(*_OPACITIES)).clamp(-6, 6)
    own, count = log_sizes[rows], there.sum(dim=1).clamp(min=1)
    cover = there * opacities[close] * torch.exp(-reach / 2)
    weight = area[close] * torch.exp(-reach / 4)
    columns = [
        lost,
        _gain_for(gone[near[:, :12]].mean(dim=1) if near.shape[1] else gone[rows]),
        _gain_for(gone.mean()).expand_as(own),
        own - _spacing(far, there, own),
        own - log_sizes[known].median(),
        own - (there * log_sizes[close]).sum(dim=1) / count,
        (log_axes[rows, 0] - log_axes[rows, 1]).clamp(max=6),
        (log_axes[rows, 1] - log_axes[rows, 2]).clamp(max=6),
        logit[rows],
        (there * logit[close]).sum(dim=1) / count,
        torch.log1p(cover.sum(dim=1)),
        _gain_for((weight * (1 - there)).sum(dim=1) / (weight.sum(dim=1) + area[rows]).clamp(min=tiny)),
    ]
    return ElementInputs(rows, torch.stack(columns, dim=1), lost, opacities[rows])


def _gain_for(share: Tensor) -> Tensor:
    return -torch.log1p(-share.clamp(max=_MOST_LOST))


def _spacing(distance: Tensor, there: Tensor, own: Tensor) -> Float[Tensor, "M"]:
    """Logarithm of the distance of a near received neighbour; the own size where there is none."""
    if distance.shape[1] < _SPACING_RANK:
        return own
    ranked = torch.where(there > 0, distance, math.inf).kthvalue(_SPACING_RANK, dim=1).values
    return torch.where(ranked.isfinite(), ranked.clamp(min=MIN_SIZE).log(), own)


class ElementNetwork(Perceptron):
    """A small perceptron that says how much of a loss sizes and how much opacities make up for."""

    def __init__(self, hidden: int = HIDDEN, *, seed: int = 0) -> None:
        super().__init__(ELEMENT_SIGNATURE, hidden, seed=seed)

    def forward(
        self, inputs: ElementInputs, trust: float | int = 1.0, base: tuple[float, float] = BASE
    ) -> tuple[Float[Tensor, "M"], Float[Tensor, "M"]]:
        """Computes the gains of size and opacity, positive.

        Args:
            inputs: What is known.
            trust: How much of the network's opinion is taken, 0 for none.
            base: Exponents that it changes.
        """
        change = trust * self.opinion(inputs.signature)
        size = torch.exp(inputs.lost * (base[0] + change[:, 0]).clamp(*_SIZES))
        power = torch.exp(inputs.lost * (base[1] + change[:, 1]).clamp(*_POWERS))
        opacity = inputs.opacity.clamp(*_OPACITIES)
        return size, -torch.expm1(power * torch.log1p(-opacity)) / opacity


def grown(
    partial: Partial, rows: Int64[Tensor, "M"], gains: tuple[Float[Tensor, "M"], Float[Tensor, "M"]]
) -> Concealed:
    """Draws what arrived with some gains, and leaves the rest out.

    Args:
        partial: What arrived.
        rows: The received elements.
        gains: Of their sizes and of their opacities.
    """
    ones = torch.ones_like(partial.log_sizes)
    size, opacity = (ones.index_put((rows,), gain) for gain in gains)
    return Concealed(size, ~partial.known, opacity)
