"""The plan: which elements share a packet."""

import bisect
import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.packets.grouping import CHUNK, contiguous_bounds, contiguous_lanes, hash_order, stratified_lanes
from splatwire.packets.limits import MAX_BLOCKS, MAX_ELEMENTS, MAX_FEATURE_GROUPS, MAX_GROUPS
from splatwire.packets.packet_id import FIRST_FEATURE, OFFSET, SCALING, PacketId
from splatwire.packets.packetization import Packetization, check_range
from splatwire.packets.tiers import Span, TierShape, check_tiers, spans_of


class PacketGroups(NamedTuple):
    """Elements by block and lane, in compressed rows: group g holds `ranks[starts[g]:starts[g + 1]]`, ascending.

    Attributes:
        ranks: All ranks (with tiers places, until they are mapped), group after group, int64, N.
        starts: Bounds of the groups, int64, G + 1. Empty groups are left out; with atomic packaging, group g is the
            packet `PacketPlan.ids[g]`; otherwise it is the `len(parts)` packets from `ids[g * len(parts)]` on.
    """

    ranks: np.ndarray
    starts: np.ndarray


@dataclass(frozen=True)
class PacketPlan:
    """Mapping between ranks and packets, rebuilt from a few numbers; constructing it computes nothing.

    With tiers, the plan speaks of places where it otherwise speaks of ranks; `splatwire.packets.tiers.tier_order` maps
    them, given the tier of every element. Names and sizes of packets follow from the plan alone.

    Attributes:
        packetization: How elements are split.
        num_elements: Elements of the scene, N.
        tiers: Sizes of the tiers; empty if there is one.
        feature_groups: Number of feature groups; 0 with atomic packaging, where it does not matter.

    Raises:
        InvalidValueError: If the scene is larger than the format holds, or the tiers are not possible.
    """

    packetization: Packetization
    num_elements: int
    tiers: tuple[TierShape, ...] = ()
    feature_groups: int = 0

    def __post_init__(self) -> None:
        least, most = (1, MAX_FEATURE_GROUPS) if self.packetization.separated else (0, 0)
        check_range(
            f"number of feature groups of a plan with {self.packetization.packaging} packaging",
            self.feature_groups,
            least,
            most,
        )
        check_range("number of elements", self.num_elements, 0, MAX_ELEMENTS)
        check_tiers(self.tiers, self.num_elements, self.packetization)
        check_range("number of blocks", self.num_blocks, 0, MAX_BLOCKS)
        check_range("number of packets", self.num_blocks * self.packetization.lanes, 0, MAX_GROUPS)

    @functools.cached_property
    def spans(self) -> tuple[Span, ...]:
        """Blocks of each tier, in order."""
        return spans_of(self.tiers, self.num_elements, self.packetization)

    @functools.cached_property
    def num_blocks(self) -> int:
        """Spatial blocks of all tiers, S."""
        return sum(span.num_blocks for span in self.spans)

    @functools.cached_property
    def _first_blocks(self) -> list[int]:
        return [span.first_block for span in self.spans]

    @functools.cached_property
    def _first_places(self) -> list[int]:
        return [span.first for span in self.spans]

    def lasting(self, block: int) -> bool:
        """Whether a block of a stream of groups of frames outlives its group (`StreamSchema.timed`)."""
        return self.tier_of(block) % 2 == 0

    def tier_of(self, block: int) -> int:
        """Tier of a block's elements, 0 for the most important.

        Raises:
            InvalidValueError: If there is no such block.
        """
        check_range("block", block, 0, self.num_blocks - 1)
        return bisect.bisect_right(self._first_blocks, block) - 1

    @functools.cached_property
    def parts(self) -> tuple[int, ...]:
        """`PacketId.part` of the packets that the elements of one block and lane are split into, ascending."""
        if not self.packetization.separated:
            return (0,)
        return (SCALING, OFFSET, *range(FIRST_FEATURE, FIRST_FEATURE + self.feature_groups))

    @functools.cached_property
    def ids(self) -> tuple[PacketId, ...]:
        """All packets that hold an element, in the order j = block * lanes + lane (then part).

        Raises:
            InvalidValueError: With hashed grouping, where only a stream knows.
        """
        self._check_fixed()
        lanes, parts = self.packetization.lanes, self.parts
        used = np.flatnonzero(self._counts()).tolist()
        return tuple(PacketId(j // lanes, j % lanes, part) for j in used for part in parts)

    def packet_index_of(self) -> np.ndarray:
        """Packet index j = block * lanes + lane of every rank, int32, N; not with hashed grouping."""
        self._check_fixed()
        lanes = np.int32(self.packetization.lanes)
        pieces = [np.empty(0, np.int32)]
        for span in self.spans:
            place = np.arange(span.num_elements, dtype=np.int32)
            block = place // np.int32(span.block_size) + np.int32(span.first_block)
            pieces.append(block * lanes + self._lanes_of(span))
        return np.concatenate(pieces)

    def groups(self) -> PacketGroups:
        """Ranks of all packets at once; with hashed grouping of all blocks, each in the order of its hashes."""
        if self.packetization.hashed:
            blocks = [self._hash_order(block) for block in range(self.num_blocks)]
            edges = np.cumsum([0, *map(len, blocks)])
            return PacketGroups(np.concatenate([np.empty(0, np.int64), *blocks]), edges.astype(np.int64))
        ranks = np.argsort(self.packet_index_of(), kind="stable")
        return PacketGroups(ranks, np.concatenate([[0], np.cumsum(self.group_counts())]))

    def group_counts(self) -> np.ndarray:
        """Elements of each group of `groups`, int64 (G); not with hashed grouping."""
        self._check_fixed()
        counts = self._counts()
        return counts[counts > 0]

    def block_ranks(self, block: int) -> np.ndarray:
        """Ranks of a block, group after group as in `groups`, int64; computed from this block alone."""
        if self.packetization.hashed:
            return self._hash_order(block)
        start, lanes = self._block_lanes(PacketId(block, 0, self.parts[0]))
        return start + np.argsort(lanes, kind="stable")

    def members(self, packet_id: PacketId, num_elements: int | None = None) -> np.ndarray:
        """Ranks of one packet's elements, ascending (hashed: in hash order), int64; computed from its block alone.

        Args:
            packet_id: The packet.
            num_elements: Its number of elements, which with hashed grouping only the packet knows.

        Raises:
            InvalidValueError: If the plan has no such block, lane or part, or not so many elements.
        """
        if num_elements is None and not self.packetization.hashed:
            start, lanes = self._block_lanes(packet_id)
            return start + np.flatnonzero(lanes == packet_id.lane)
        if num_elements is None or not self.fits(packet_id, num_elements):
            raise InvalidValueError(f"the plan has no packet {packet_id.filename} with {num_elements} elements")
        if not self.packetization.hashed:
            return self.members(packet_id)
        return self._hash_order(packet_id.block)[packet_id.lane : packet_id.lane + num_elements]

    def run(self, packet_id: PacketId, num_elements: int) -> slice:
        """Where the elements of a packet that fits are in `block_ranks` of its block."""
        if self.packetization.hashed:
            return slice(packet_id.lane, packet_id.lane + num_elements)
        first = int(_lane_counts(self, packet_id.block)[: packet_id.lane].sum())
        return slice(first, first + num_elements)

    def count(self, packet_id: PacketId) -> int:
        """Elements of one packet; 0 if the plan has no such packet. Cheap: at most one block is hashed.

        With hashed grouping, the elements from the packet's first position to its block's end: the most it can hold.
        """
        p = self.packetization
        if not (0 <= packet_id.block < self.num_blocks and packet_id.lane >= 0 and packet_id.part in self.parts):
            return 0
        if p.hashed:
            return max(0, self.block_elements(packet_id.block) - packet_id.lane)
        if packet_id.lane >= self._span(packet_id.block).lanes:
            return 0
        return int(_lane_counts(self, packet_id.block)[packet_id.lane])

    def fits(self, packet_id: PacketId, num_elements: int) -> bool:
        """Whether the plan has such a packet with so many elements."""
        count = self.count(packet_id)
        return 1 <= num_elements <= count if self.packetization.hashed else num_elements == count > 0

    def block_elements(self, block: int) -> int:
        """Elements of a block."""
        return self._span(block).block_elements(block)

    def name_hashed(self, place: int) -> PacketId:
        """Name of the packet of hashed grouping that begins with the element that is n-th in `groups`."""
        span = self.spans[bisect.bisect_right(self._first_places, place) - 1]
        block, position = divmod(place - span.first, span.block_size)
        return PacketId(span.first_block + block, position)

    def _span(self, block: int) -> Span:
        return self.spans[self.tier_of(block)]

    def _hash_order(self, block: int) -> np.ndarray:
        start = self._span(block).block_start(block)
        return hash_order(start, start + self.block_elements(block), self.packetization.seed)

    def _check_fixed(self) -> None:
        if self.packetization.hashed:
            raise InvalidValueError("packets of hashed grouping are cut by their size: a plan does not know them")

    def _lanes_of(self, span: Span) -> np.ndarray:
        """Lane of every place of a span, uint8."""
        p = self.packetization
        if p.grouping == "stratified":
            return stratified_lanes(span.first, span.first + span.num_elements, span.lanes, p.seed)
        num_full, rest = divmod(span.num_elements, span.block_size)
        full = contiguous_lanes(span.block_size, span.lanes)
        return np.concatenate([np.tile(full, num_full), contiguous_lanes(rest, span.lanes)])

    def _block_lanes(self, packet_id: PacketId) -> tuple[int, np.ndarray]:
        """First rank of a packet's block, and the lane of each of the block's ranks."""
        p = self.packetization
        span = self._span(packet_id.block)
        check_range("lane", packet_id.lane, 0, span.lanes - 1)
        if packet_id.part not in self.parts:
            raise InvalidValueError(f"{p.packaging} packaging has no packet {packet_id.filename}")
        start, size = span.block_start(packet_id.block), span.block_elements(packet_id.block)
        if p.grouping == "stratified":
            return start, stratified_lanes(start, start + size, span.lanes, p.seed)
        return start, contiguous_lanes(size, span.lanes)

    def _counts(self) -> np.ndarray:
        """Elements of each (block, lane), empty ones too, int64, S * lanes."""
        lanes = self.packetization.lanes
        counts = np.zeros((self.num_blocks, lanes), np.int64)
        if self.packetization.grouping == "stratified":
            for span in self.spans:
                _count_lanes(span, self.packetization.seed, counts[span.first_block :][: span.num_blocks])
            return counts.ravel()
        for span in self.spans:
            num_full, rest = divmod(span.num_elements, span.block_size)
            rows = counts[span.first_block :, : span.lanes]
            rows[:num_full] = np.diff(contiguous_bounds(span.block_size, span.lanes))
            if rest:
                rows[num_full] = np.diff(contiguous_bounds(rest, span.lanes))
        return counts.ravel()


def _count_lanes(span: Span, seed: int, counts: np.ndarray) -> None:
    """Counts a span's places of each block and lane into `counts`, int64 (blocks, lanes), some blocks at a time."""
    blocks = max(CHUNK // max(span.block_size, counts.shape[1]), 1)
    for block in range(0, span.num_blocks, blocks):
        begin, end = block * span.block_size, min((block + blocks) * span.block_size, span.num_elements)
        lanes = stratified_lanes(span.first + begin, span.first + end, span.lanes, seed)
        here = counts[block : block + blocks]
        index = np.arange(end - begin) // span.block_size * here.shape[1] + lanes
        here[:] = np.bincount(index, minlength=here.size).reshape(here.shape)


@functools.lru_cache(maxsize=2048)
def _lane_counts(plan: PacketPlan, block: int) -> np.ndarray:
    """Elements in each lane of a block; remembered because the packets of a block are asked for one after another."""
    _, lanes = plan._block_lanes(PacketId(block, 0, plan.parts[0]))
    return np.bincount(lanes, minlength=plan.packetization.lanes)
