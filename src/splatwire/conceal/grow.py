"""Concealment that enlarges received elements to cover lost ones."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.conceal.base import Concealed, check_at_least
from splatwire.conceal.registry import register_concealer
from splatwire.model import Partial
from splatwire.ops.knn import NeighborTree, nearest_others

_CHUNK = 1 << 15
_MOST_OPAQUE, _LEAST_OPAQUE = 0.999, 1e-6


@register_concealer("grow")
@dataclass(frozen=True)
class Grow:
    """Leaves lost anchors out and enlarges received ones by `(1 - rho) ** -exponent`, `rho` = share lost around them.

    With exponent 1/2 the covered area of a surface stays what it was: of `n` discs `(1 - rho) n` are left, each
    `1 / (1 - rho)` as large. Neighbours count by the size that is expected of them, by the prior or by what the sender
    says of their tier (`Partial.sizes`): where all that matters is there and only small ones are lost, as with a
    stream whose important anchors are protected, large anchors must not grow over what is small. With the last third to
    half of the packets of two scenes cut off, tiers in order of importance, the prior's sizes were worth 0.4 and 0.5 dB
    over counting heads; where all are lost alike, 0.01 to 0.05.

    How the growth divides into size and opacity is the elements' (`Coverage`). Of explicit Gaussians, the opacity o
    grows to `1 - (1 - o) ** (1 - rho) ** -0.8` and the size much less: n in a row let as much light through as those of
    them that arrived would have to.

    Attributes:
        neighbors: How many nearest anchors (received or lost, not counting the anchor itself) `rho` is taken over.
        exponent: Power of the share that is left, times the elements' `Coverage`; 0 does nothing.
        max_excess: Upper limit of the gain as a multiple of the gain that the loss of the whole scene would give, at
            least 1. A few anchors in the middle of large holes would otherwise grow over what is intact: on an official
            model at 20 % loss, 1.08 was worth 0.14 dB over no limit. Infinite for none.
        max_gain: Upper limit of the gain, which would be infinite where all neighbours are lost.
        nearest: The neighbours, where they are known (`knowing`).
    """

    neighbors: int = 64
    exponent: float = 0.5
    max_excess: float = 1.08
    max_gain: float = 4.0
    nearest: Int64[np.ndarray, "N k"] | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        check_at_least("number of neighbours", self.neighbors, 1)
        check_at_least("exponent of the gain", self.exponent, 0)
        check_at_least("largest excess of the gain", self.max_excess, 1)
        check_at_least("largest gain", self.max_gain, 1)

    @property
    def name(self) -> str:
        """`grow`."""
        return "grow"

    def knowing(self, partial: Partial) -> "Grow":
        """The same for many states of one scene: finds neighbours once, if what arrives does not change them."""
        if partial.expectation is None:
            return self  # where a lost element stands depends on those that arrived
        everyone = np.ones(partial.scene.num_elements, np.bool_)
        parts = [index for _, index in _neighbors_of(partial.places, everyone, self.neighbors)]
        return replace(self, nearest=np.concatenate(parts))

    def __call__(self, partial: Partial) -> Concealed:
        """See `Concealer`."""
        known, coverage = partial.known, partial.scene.COVERAGE
        left = 1 - lost_share(partial.places, known, self.neighbors, partial.sizes, self.nearest)
        left = np.where(known, self.limited(left, known, partial.tier_sizes), np.ones_like(left))
        size = left ** -(self.exponent * coverage.size)
        if not coverage.opacity:
            return Concealed(size, ~known)
        opacities = partial.elements.opacities
        opaque = 1 - (1 - np.minimum(opacities, _MOST_OPAQUE)) ** (left ** -(self.exponent * coverage.opacity))
        gain = np.maximum(np.where(known, opaque / np.maximum(opacities, _LEAST_OPAQUE), np.ones_like(left)), 1)
        return Concealed(size, ~known, gain)

    def gain(
        self,
        left: Float[np.ndarray, "M"],
        known: Bool[np.ndarray, "N"],
        tier_sizes: Float[np.ndarray, "N"] | None = None,
    ) -> Float[np.ndarray, "M"]:
        """Gains where some share of the neighbours is left.

        Args:
            left: Share of the neighbours that were received.
            known: What was received of the whole scene, which limits the gain.
            tier_sizes: What each counts for there; all alike where the sender does not say.
        """
        return self.limited(left, known, tier_sizes) ** -self.exponent

    def limited(
        self,
        left: Float[np.ndarray, "M"],
        known: Bool[np.ndarray, "N"],
        tier_sizes: Float[np.ndarray, "N"] | None = None,
    ) -> Float[np.ndarray, "M"]:
        """Shares that are left, kept so large that no gain is beyond its limit; arguments as of `gain`."""
        # A power of a float that is barely above 0 is finite, but 0 ** -x is not: limit the base, not the result.
        overall = max(received_share(known, tier_sizes), 1e-9) if len(known) else 1.0
        most = min(self.max_gain, self.max_excess * overall**-self.exponent)
        least = most ** (-1 / self.exponent) if self.exponent else 1.0
        return np.maximum(left, left.dtype.type(least))


def received_share(known: Bool[np.ndarray, "N"], tier_sizes: Float[np.ndarray, "N"] | None = None) -> float:
    """Share of a scene that was received: of its elements, or of the sizes that their tiers have."""
    if tier_sizes is None:
        return float(known.mean())
    sizes = tier_sizes.astype(np.float64)
    return float((sizes * known).sum() / sizes.sum())


def lost_share(
    positions: Float[np.ndarray, "N 3"],
    known: Bool[np.ndarray, "N"],
    neighbors: int,
    weights: Float[np.ndarray, "N"] | None = None,
    nearest: Int64[np.ndarray, "N k"] | None = None,
) -> Float[np.ndarray, "N"]:
    """Share of what is lost among the nearest others of each received anchor; 0 for lost and for lonely anchors.

    Args:
        positions: Anchors, received or lost.
        known: Which were received.
        neighbors: How many others are looked at.
        weights: How much each anchor counts, above 0; all alike if not given.
        nearest: Those others, where they are known.
    """
    share = np.zeros(len(positions), positions.dtype)
    weight = np.ones(len(positions)) if weights is None else weights.astype(np.float64)
    lost = weight * ~known
    if bool(known.all()) or not bool(known.any()):
        return share
    there = np.flatnonzero(known)
    found = _neighbors_of(positions, known, neighbors) if nearest is None else [(there, nearest[there])]
    for own, index in found:
        if index.shape[1]:
            share[own] = lost_share_among(index, lost, weight).astype(share.dtype)
    return share


def _neighbors_of(
    positions: Float[np.ndarray, "N 3"], which: Bool[np.ndarray, "N"], neighbors: int
) -> Iterator[tuple[Int64[np.ndarray, "m"], Int64[np.ndarray, "m k"]]]:
    """Some elements at a time, and the nearest others of each."""
    tree = NeighborTree(positions)
    chosen = np.flatnonzero(which)
    for first in range(0, len(chosen), _CHUNK):
        own = chosen[first : first + _CHUNK]
        yield own, nearest_others(tree, positions[own], own, neighbors)[0]


def lost_share_among(
    neighbors: Int64[np.ndarray, "M k"], lost: Float[np.ndarray, "N"], weights: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "M"]:
    """Share of what is lost among given neighbours.

    Args:
        neighbors: Indices of the neighbours of some anchors, at least one each.
        lost: What each anchor counts where it is lost, 0 where it was received.
        weights: What each anchor counts.
    """
    return lost[neighbors].sum(axis=1) / weights[neighbors].sum(axis=1)
