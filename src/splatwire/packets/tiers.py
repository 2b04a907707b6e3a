"""Tiers: elements grouped by importance, each in blocks and packets of its own, so that they can be protected apart.

With tiers, elements have *places* beside their ranks: first those of tier 0 by rank, then those of tier 1, and so on.
A plan is arithmetic on places, blocks are runs of places, and no block holds two tiers: a packet's block names its
tier. With one tier, place and rank are the same thing.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.packets.limits import MAX_ELEMENTS, MAX_SPANS, MAX_TIERS
from splatwire.packets.packetization import Packetization, check_range

LANE_ELEMENTS = 64
"""A tier has fewer lanes than the packetization says rather than packets of fewer elements than this."""


@dataclass(frozen=True)
class TierShape:
    """Size of a tier.

    Attributes:
        num_elements: Elements of the tier.
        lanes: Packets that a block of the tier is split into, at most those of the packetization.
    """

    num_elements: int
    lanes: int


class Span(NamedTuple):
    """Consecutive blocks of equal size but the last: those of one tier.

    Attributes:
        first: First place.
        num_elements: Elements.
        block_size: Most elements of a block.
        lanes: Packets that a block is split into.
        first_block: Number of the first block.
    """

    first: int
    num_elements: int
    block_size: int
    lanes: int
    first_block: int

    @property
    def num_blocks(self) -> int:
        """Number of blocks."""
        return -(-self.num_elements // self.block_size)

    def block_elements(self, block: int) -> int:
        """Elements of one of the blocks."""
        return min(self.block_size, self.num_elements - (block - self.first_block) * self.block_size)

    def block_start(self, block: int) -> int:
        """First place of one of the blocks."""
        return self.first + (block - self.first_block) * self.block_size


def shape_tiers(tiers: np.ndarray, packetization: Packetization) -> tuple[TierShape, ...]:
    """Shapes of the tiers of some elements; none if all of them are in one.

    Args:
        tiers: Tier of each element, integers from 0 (most important), N.
        packetization: How elements are split.

    Raises:
        InvalidValueError: If there are too many tiers, or one between others is empty.
    """
    counts = np.bincount(tiers.astype(np.int64)).tolist()
    if len(counts) > MAX_TIERS:
        raise InvalidValueError(f"{len(counts)} tiers, at most {MAX_TIERS} are possible")
    for tier, count in enumerate(counts):
        if not count:
            raise InvalidValueError(
                f"tier {tier} of {len(counts)} has no element: choose larger shares, or fewer tiers"
            )
    if len(counts) < 2:
        return ()
    return tuple(TierShape(n, _lanes(packetization, n)) for n in counts)


def _lanes(packetization: Packetization, num_elements: int) -> int:
    return min(packetization.lanes, max(1, min(num_elements, packetization.block_size) // LANE_ELEMENTS))


def tier_order(tiers: np.ndarray) -> np.ndarray:
    """Ranks by place: what turns a plan's places into ranks.

    Args:
        tiers: Tier of each element by rank, N.

    Returns:
        Rank of the element at each place, int64, N.
    """
    return np.argsort(tiers, kind="stable").astype(np.int64)


def check_pairs(tiers: tuple[TierShape, ...], *, timed: bool) -> None:
    """Tiers have somebody in them; groups of frames come in pairs, either of which may be empty.

    Args:
        tiers: Sizes of the tiers; empty if there is one.
        timed: Whether they are groups of frames, see `StreamSchema.timed`.

    Raises:
        InvalidValueError: If not.
    """
    if timed and (len(tiers) % 2 or not tiers):
        raise InvalidValueError(f"{len(tiers)} tiers are no pairs, one for each group of frames")
    if not timed and not all(tier.num_elements for tier in tiers):
        raise InvalidValueError("a tier has no element")


def check_tiers(tiers: tuple[TierShape, ...], num_elements: int, packetization: Packetization) -> None:
    """Checks tiers by arithmetic alone.

    Raises:
        InvalidValueError: If they contradict each other or the packetization.
    """
    if not tiers:
        return
    check_range("number of tiers", len(tiers), 2, MAX_SPANS)
    for tier in tiers:
        check_range("number of elements of a tier", tier.num_elements, 0, MAX_ELEMENTS)
        check_range("number of lanes of a tier", tier.lanes, 1, packetization.lanes)
    if sum(tier.num_elements for tier in tiers) != num_elements:
        raise InvalidValueError(f"the tiers' elements do not add up to {num_elements}")
    if packetization.packaging != "atomic":
        raise InvalidValueError(f"{packetization.packaging} packaging knows no tiers")


def spans_of(tiers: tuple[TierShape, ...], num_elements: int, packetization: Packetization) -> tuple[Span, ...]:
    """Blocks of each tier; those of a tier are as equal as possible, so that no small one is left at its end."""
    if not tiers:
        return (Span(0, num_elements, packetization.block_size, packetization.lanes, 0),)
    spans: list[Span] = []
    for tier in tiers:
        last = spans[-1] if spans else Span(0, 0, 1, 1, 0)
        size = -(-tier.num_elements // max(1, -(-tier.num_elements // packetization.block_size))) or 1
        first, block = last.first + last.num_elements, last.first_block + last.num_blocks
        spans.append(Span(first, tier.num_elements, size, tier.lanes, block))
    return tuple(spans)
