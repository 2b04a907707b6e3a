"""The packet plan: divides the indices of elements (anchors or Gaussians) among packets."""

import bisect
import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.arguments import check_fields
from splatwire.bitstream.grouping import CHUNK, contiguous_bounds, contiguous_lanes, hash_order, stratified_lanes
from splatwire.bitstream.limits import MAX_BLOCKS, MAX_ELEMENTS, MAX_FEATURE_GROUPS, MAX_STREAM_LANES
from splatwire.bitstream.packet_id import FIRST_FEATURE, OFFSET, SCALING, PacketId
from splatwire.bitstream.packetization import Packetization, check_range
from splatwire.bitstream.tiers import Span, TierCounts, check_tiers, spans_of
from splatwire.errors import InvalidValueError


class PacketMembers(NamedTuple):
    """Elements of each packet of a stream.

    If each attribute has separate packets, the packets that contain the same elements have one common entry. The result
    of `PacketPlan.all_members` with hashed grouping has an entry for each block instead.

    Attributes:
        indices: Plan indices (see `PacketPlan`) of all elements, packet after packet, int64 (N). Packet p has the
            elements `indices[starts[p]:starts[p + 1]]`.
        starts: Start of each packet in `indices`, followed by the end of the last packet, int64 (P + 1).
    """

    indices: np.ndarray
    starts: np.ndarray


@dataclass(frozen=True)
class PacketPlan:
    """Mapping between element indices and packets, computed from a few parameters in the manifest.

    An element (anchor or Gaussian) is identified by its *plan index*, its index in plan order. The codec determines
    which element has which plan index:

    * Anchors are sorted by importance tier, and within a tier by coding order. With a single tier, plan order is coding
      order. The array from `bitstream.tiers.tier_order` converts a plan index to an index in coding order.
    * The encoder of explicit Gaussians chooses the members of each packet (`codec.gaussians.source_scene`), and the
      plan gives them their indices. The plan index of a Gaussian is its index in the decoded scene.

    Attributes:
        packetization: Parameters of the division into packets.
        num_elements: Number of elements of the scene, N.
        tiers: Element counts of the importance tiers; empty for a single tier.
        num_feature_groups: Number of channel groups of the anchor feature if each group has separate packets; otherwise
            0.

    Raises:
        InvalidValueError: If the scene exceeds a limit of the format, or the tiers are inconsistent.
    """

    packetization: Packetization
    num_elements: int
    tiers: tuple[TierCounts, ...] = ()
    num_feature_groups: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        min_groups, max_groups = (1, MAX_FEATURE_GROUPS) if self.packetization.separated else (0, 0)
        check_range(
            f"number of feature groups of a plan with {self.packetization.packaging} packaging",
            self.num_feature_groups,
            min_groups,
            max_groups,
        )
        check_range("number of elements", self.num_elements, 0, MAX_ELEMENTS)
        check_tiers(self.tiers, self.num_elements, self.packetization)
        check_range("number of blocks", self.num_blocks, 0, MAX_BLOCKS)
        check_range("number of packets", self.num_blocks * self.packetization.lanes, 0, MAX_STREAM_LANES)

    @functools.cached_property
    def spans(self) -> tuple[Span, ...]:
        """Range of consecutive blocks of each importance tier."""
        return spans_of(self.tiers, self.num_elements, self.packetization)

    @functools.cached_property
    def num_blocks(self) -> int:
        """Number of spatial blocks, S."""
        return sum(span.num_blocks for span in self.spans)

    @functools.cached_property
    def _first_blocks(self) -> list[int]:
        return [span.first_block for span in self.spans]

    @functools.cached_property
    def _first_indices(self) -> list[int]:
        return [span.first for span in self.spans]

    @functools.cached_property
    def gop_spans(self) -> tuple[tuple[Span, Span], ...]:
        """For each group of pictures (GOP), its blocks of keyframe Gaussians and of motion. Only for sequences."""
        return tuple(zip(self.spans[::2], self.spans[1::2], strict=True))

    def is_keyframe(self, block: int) -> bool:
        """True if a block contains keyframe Gaussians, which later groups of frames also need. Only for sequences."""
        return self.tier_of(block) % 2 == 0

    def gop_of_block(self, block: int) -> int:
        """Index of the group of pictures (GOP) that a block belongs to. Only for sequences.

        Each group has two tiers: first its keyframe Gaussians, then its motion.

        Raises:
            InvalidValueError: If the block does not exist.
        """
        return self.tier_of(block) // 2

    def tier_of(self, block: int) -> int:
        """Importance tier of a block, 0 first; in a clip, two per group of frames (keyframe Gaussians, motion).

        Raises:
            InvalidValueError: If the block does not exist.
        """
        check_range("block", block, 0, self.num_blocks - 1)
        return bisect.bisect_right(self._first_blocks, block) - 1

    @functools.cached_property
    def parts(self) -> tuple[int, ...]:
        """Values of `PacketId.part` in this stream: attributes with separate packets, or only 0 (whole elements)."""
        if not self.packetization.separated:
            return (0,)
        return (SCALING, OFFSET, *range(FIRST_FEATURE, FIRST_FEATURE + self.num_feature_groups))

    @functools.cached_property
    def ids(self) -> tuple[PacketId, ...]:
        """Ids of all packets, ascending.

        Raises:
            InvalidValueError: With the grouping `hashed`, whose packets depend on the sizes of the coded elements.
        """
        self._check_fixed()
        lanes, parts = self.packetization.lanes, self.parts
        used = np.flatnonzero(self._counts()).tolist()
        return tuple(PacketId(j // lanes, j % lanes, part) for j in used for part in parts)

    def packet_index_of(self) -> np.ndarray:
        """Returns the packet of each element as `block * packetization.lanes + index_in_block`, int32 (N).

        Elements are in plan order. Packets that differ only in their attribute (`PacketId.part`) have the same number.

        Raises:
            InvalidValueError: With the grouping `hashed`, whose packets depend on the sizes of the coded elements.
        """
        self._check_fixed()
        lanes = np.int32(self.packetization.lanes)
        pieces = [np.empty(0, np.int32)]
        for span in self.spans:
            index = np.arange(span.num_elements, dtype=np.int32)
            block = index // np.int32(span.block_size) + np.int32(span.first_block)
            pieces.append(block * lanes + self._lanes_of(span))
        return np.concatenate(pieces)

    def all_members(self) -> PacketMembers:
        """Returns the elements of each packet of the stream.

        If packets are filled up to a size limit (grouping `hashed`), the plan does not determine the packet of an
        element. The result then has one entry for each block, with the elements of the whole block.
        """
        if self.packetization.hashed:
            blocks = [self._hash_order(block) for block in range(self.num_blocks)]
            edges = np.cumsum([0, *map(len, blocks)])
            return PacketMembers(np.concatenate([np.empty(0, np.int64), *blocks]), edges.astype(np.int64))
        indices = np.argsort(self.packet_index_of(), kind="stable")
        return PacketMembers(indices, np.concatenate([[0], np.cumsum(self.member_counts())]))

    def member_counts(self) -> np.ndarray:
        """Returns the number of elements of each packet, in the order of `all_members`, int64 (P).

        Raises:
            InvalidValueError: With the grouping `hashed`, whose packets depend on the sizes of the coded elements.
        """
        self._check_fixed()
        counts = self._counts()
        return counts[counts > 0]

    def block_indices(self, block: int) -> np.ndarray:
        """Returns the elements of a block, packet after packet, int64 (elements).

        Each element is given by its plan index.
        """
        if self.packetization.hashed:
            return self._hash_order(block)
        start, lanes = self._block_lanes(PacketId(block, 0, self.parts[0]))
        return start + np.argsort(lanes, kind="stable")

    def members(self, packet_id: PacketId, num_elements: int | None = None) -> np.ndarray:
        """Returns the elements of a packet, each given by its plan index, int64.

        Args:
            packet_id: The packet.
            num_elements: Number of elements of the packet. Required if packets are filled up to a size limit (grouping
                `hashed`); otherwise it may be None.

        Raises:
            InvalidValueError: If the plan has no packet with this id, or the number of elements does not fit.
        """
        if num_elements is None and not self.packetization.hashed:
            start, lanes = self._block_lanes(packet_id)
            return start + np.flatnonzero(lanes == packet_id.index_in_block)
        if num_elements is None or not self.fits(packet_id, num_elements):
            raise InvalidValueError(f"the plan has no packet {packet_id.filename} with {num_elements} elements")
        if not self.packetization.hashed:
            return self.members(packet_id)
        return self._hash_order(packet_id.block)[packet_id.index_in_block : packet_id.index_in_block + num_elements]

    def packet_slice(self, packet_id: PacketId, num_elements: int) -> slice:
        """Returns the slice of the array `block_indices(packet_id.block)` that contains the elements of a packet.

        Args:
            packet_id: The packet.
            num_elements: Number of elements of the packet.
        """
        if self.packetization.hashed:
            return slice(packet_id.index_in_block, packet_id.index_in_block + num_elements)
        first = int(_lane_counts(self, packet_id.block)[: packet_id.index_in_block].sum())
        return slice(first, first + num_elements)

    def count(self, packet_id: PacketId) -> int:
        """Number of elements of a packet, or 0 if the plan has no packet with this id.

        If packets are filled up to a size limit (grouping `hashed`), the result is an upper limit.
        """
        p = self.packetization
        index = packet_id.index_in_block
        if not (0 <= packet_id.block < self.num_blocks and index >= 0 and packet_id.part in self.parts):
            return 0
        if p.hashed:
            return max(0, self.block_elements(packet_id.block) - index)
        if index >= self._span(packet_id.block).lanes:
            return 0
        return int(_lane_counts(self, packet_id.block)[index])

    def fits(self, packet_id: PacketId, num_elements: int) -> bool:
        """True if the plan has a packet with this id and this number of elements."""
        count = self.count(packet_id)
        return 1 <= num_elements <= count if self.packetization.hashed else num_elements == count > 0

    def block_elements(self, block: int) -> int:
        """Number of elements of a block."""
        return self._span(block).block_elements(block)

    def id_of_hashed(self, first_index: int) -> PacketId:
        """Returns the id of the packet that starts with a given element. Only for plans with the grouping `hashed`.

        Args:
            first_index: Index of the packet's first element in `all_members().indices`.
        """
        span = self.spans[bisect.bisect_right(self._first_indices, first_index) - 1]
        block, index_in_block = divmod(first_index - span.first, span.block_size)
        return PacketId(span.first_block + block, index_in_block)

    def _span(self, block: int) -> Span:
        return self.spans[self.tier_of(block)]

    def _hash_order(self, block: int) -> np.ndarray:
        start = self._span(block).block_start(block)
        return hash_order(start, start + self.block_elements(block), self.packetization.seed)

    def _check_fixed(self) -> None:
        if self.packetization.hashed:
            raise InvalidValueError(
                "packets of hashed grouping depend on the sizes of coded elements, which are not in a plan"
            )

    def _lanes_of(self, span: Span) -> np.ndarray:
        """Returns the packet of each element of an importance tier, as an index within the element's block, uint8."""
        p = self.packetization
        if p.grouping == "stratified":
            return stratified_lanes(span.first, span.first + span.num_elements, span.lanes, p.seed)
        num_full, rest = divmod(span.num_elements, span.block_size)
        full = contiguous_lanes(span.block_size, span.lanes)
        return np.concatenate([np.tile(full, num_full), contiguous_lanes(rest, span.lanes)])

    def _block_lanes(self, packet_id: PacketId) -> tuple[int, np.ndarray]:
        """Assigns the elements of a block to the packets of this block.

        Args:
            packet_id: Id of any packet of the block.

        Returns:
            Two values. The first is the first plan index of the block. The second is an array with one entry for each
            element of the block: the index of the element's packet within the block, uint8.

        Raises:
            InvalidValueError: If the plan has no such packet.
        """
        p = self.packetization
        span = self._span(packet_id.block)
        check_range("index of a packet in its block", packet_id.index_in_block, 0, span.lanes - 1)
        if packet_id.part not in self.parts:
            raise InvalidValueError(f"{p.packaging} packaging has no packet {packet_id.filename}")
        start, size = span.block_start(packet_id.block), span.block_elements(packet_id.block)
        if p.grouping == "stratified":
            return start, stratified_lanes(start, start + size, span.lanes, p.seed)
        return start, contiguous_lanes(size, span.lanes)

    def _counts(self) -> np.ndarray:
        """Returns the number of elements of each packet of the stream, block by block, int64.

        Every block has `packetization.lanes` entries. In tiers with fewer packets per block, the other entries are 0.
        """
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
    """Counts the elements of every packet of an importance tier that assigns elements to packets by hash.

    This is the grouping `stratified`.

    Args:
        span: Range of blocks of the tier.
        seed: Seed of the hash.
        counts: Output: number of elements of each packet in each block, int64 (blocks, packets per block).
    """
    blocks = max(CHUNK // max(span.block_size, counts.shape[1]), 1)
    for block in range(0, span.num_blocks, blocks):
        begin, end = block * span.block_size, min((block + blocks) * span.block_size, span.num_elements)
        lanes = stratified_lanes(span.first + begin, span.first + end, span.lanes, seed)
        counts_of_blocks = counts[block : block + blocks]
        index = np.arange(end - begin) // span.block_size * counts_of_blocks.shape[1] + lanes
        counts_of_blocks[:] = np.bincount(index, minlength=counts_of_blocks.size).reshape(counts_of_blocks.shape)


@functools.lru_cache(maxsize=2048)
def _lane_counts(plan: PacketPlan, block: int) -> np.ndarray:
    """Returns the number of elements in each packet of a block, int64 (packets)."""
    _, lanes = plan._block_lanes(PacketId(block, 0, plan.parts[0]))
    return np.bincount(lanes, minlength=plan.packetization.lanes)
