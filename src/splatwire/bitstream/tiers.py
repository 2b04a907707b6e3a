"""Importance tiers: elements are grouped by importance into separate packets, with different protection.

Every anchor has an index in *coding order* (its rank) and an index in *plan order* (its plan index). Plan order sorts
the anchors by tier, and within a tier by coding order. With one tier, both indices are equal. Explicit Gaussians have
only a plan index (see `PacketPlan`), which is also their index in the decoded scene.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.arguments import CheckedFields, array_of, checked
from splatwire.bitstream.limits import MAX_ELEMENTS, MAX_SPANS, MAX_TIERS
from splatwire.bitstream.packetization import Packetization, check_range
from splatwire.errors import InvalidValueError

MIN_PACKET_ELEMENTS = 64
"""Minimum number of elements per packet of a tier; smaller tiers have fewer packets per block."""


@dataclass(frozen=True)
class TierCounts(CheckedFields):
    """Number of elements of one importance tier, and number of packets per block.

    Attributes:
        num_elements: Number of elements of the tier.
        lanes: Number of packets into which each block of the tier is divided.
    """

    num_elements: int
    lanes: int


class Span(NamedTuple):
    """Blocks of one importance tier, which are consecutive blocks of the stream.

    Attributes:
        first: Index of the tier's first element when all elements of the stream are sorted by tier.
        num_elements: Number of elements of the tier.
        block_size: Maximum number of elements of a block of the tier.
        lanes: Number of packets into which each block is divided.
        first_block: Index within the stream of the tier's first block.
    """

    first: int
    num_elements: int
    block_size: int
    lanes: int
    first_block: int

    @property
    def num_blocks(self) -> int:
        """Number of blocks of this importance tier."""
        return -(-self.num_elements // self.block_size)

    @property
    def blocks(self) -> range:
        """Indices within the stream of the tier's blocks."""
        return range(self.first_block, self.first_block + self.num_blocks)

    def block_elements(self, block: int) -> int:
        """Number of elements of a block, given the block's index within the stream."""
        return min(self.block_size, self.num_elements - (block - self.first_block) * self.block_size)

    def block_start(self, block: int) -> int:
        """Returns the index of a block's first element among all elements of the stream, sorted by importance tier.

        Args:
            block: Index of the block within the stream.
        """
        return self.first + (block - self.first_block) * self.block_size


@checked
def count_tiers(tiers: np.ndarray, packetization: Packetization) -> tuple[TierCounts, ...]:
    """Counts the elements of each importance tier, and chooses the number of packets per block of each tier.

    Args:
        tiers: Importance tier of each element, integers from 0 (most important), N.
        packetization: Parameters of the division into packets.

    Returns:
        Element counts of the tiers; empty for a single tier.

    Raises:
        InvalidValueError: If the number of tiers exceeds its limit, or a tier before the last is empty.
    """
    tiers = array_of(tiers, "tiers", ("N",), "i", 0)
    counts = np.bincount(tiers.astype(np.int64)).tolist() if tiers.max(initial=0) < MAX_TIERS else []
    if not counts and tiers.size:
        raise InvalidValueError(f"{tiers.max() + 1} tiers, at most {MAX_TIERS} are possible")
    for tier, count in enumerate(counts):
        if not count:
            raise InvalidValueError(
                f"tier {tier} of {len(counts)} has no element: choose larger shares, or fewer tiers"
            )
    if len(counts) < 2:
        return ()
    return tuple(TierCounts(n, _lanes(packetization, n)) for n in counts)


def _lanes(packetization: Packetization, num_elements: int) -> int:
    return min(packetization.lanes, max(1, min(num_elements, packetization.block_size) // MIN_PACKET_ELEMENTS))


@checked
def tier_order(tiers: np.ndarray) -> np.ndarray:
    """Sorts elements by importance tier. Elements of one tier keep their order.

    Args:
        tiers: Tier of each element, N.

    Returns:
        Entry i is the original index of the i-th element in sorted order, int64, N.
    """
    return np.argsort(array_of(tiers, "tiers", ("N",), "i"), kind="stable").astype(np.int64)


def check_gop_tiers(tiers: tuple[TierCounts, ...], *, timed: bool) -> None:
    """Checks that the tiers (parts with separate packets) of a stream are possible for a sequence or a static scene.

    A sequence needs two tiers for each group of pictures: one with keyframe Gaussians, and one with motion. In a static
    scene, a tier contains elements of similar importance, and must not be empty.

    Args:
        tiers: Element counts of the tiers; empty for a single tier.
        timed: True for a sequence.

    Raises:
        InvalidValueError: If a tier of a static scene is empty, or the number of tiers of a sequence is 0 or odd.
    """
    if timed and (len(tiers) % 2 or not tiers):
        raise InvalidValueError(f"{len(tiers)} tiers are no pairs, one for each group of frames")
    if not timed and not all(tier.num_elements for tier in tiers):
        raise InvalidValueError("a tier has no element")


def check_tiers(tiers: tuple[TierCounts, ...], num_elements: int, packetization: Packetization) -> None:
    """Checks that the element counts of importance tiers fit the number of elements and the packetization.

    Raises:
        InvalidValueError: If the tiers contradict the number of elements or the packetization, or if there are too
            many.
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


def spans_of(tiers: tuple[TierCounts, ...], num_elements: int, packetization: Packetization) -> tuple[Span, ...]:
    """Divides each importance tier into blocks; returns the range of blocks of each tier.

    The blocks of a tier have nearly equal sizes. Without tiers, all blocks but the last have the maximum size.

    Args:
        tiers: Element counts of the tiers. If empty, all elements form a single tier.
        num_elements: Number of elements of the scene.
        packetization: Parameters of the division into packets, with the maximum size of a block.
    """
    if not tiers:
        return (Span(0, num_elements, packetization.block_size, packetization.lanes, 0),)
    spans: list[Span] = []
    for tier in tiers:
        last = spans[-1] if spans else Span(0, 0, 1, 1, 0)
        size = -(-tier.num_elements // max(1, -(-tier.num_elements // packetization.block_size))) or 1
        first, block = last.first + last.num_elements, last.first_block + last.num_blocks
        spans.append(Span(first, tier.num_elements, size, tier.lanes, block))
    return tuple(spans)
