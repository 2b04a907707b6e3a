"""The packetization: which anchors share a packet, and how a packet is called."""

import functools
import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.packets.grouping import contiguous_bounds, contiguous_lanes, hash_order, stratified_lanes

ORDERS = ("morton", "raster")
GROUPINGS = ("stratified", "contiguous", "hashed")
PARTS = ("anchor", "feature", "scaling", "offset")
"""What a packet carries of its anchors, by `PacketId.part`; `anchor` is everything. With separated packaging, where the
offset masks go (into `offset`, or into the side information as in HAC++) is for the codec to say."""
PACKAGING_PARTS = {"atomic": (0,), "separated": (1, 2, 3)}
"""Parts that the anchors of one block and lane are split into, each in a packet of its own."""

MAX_ANCHORS = 1 << 28
MAX_BLOCK_SIZE = (1 << 16) - 1
MAX_BLOCKS = 1 << 24
MAX_LANES = 1 << 8
MAX_HASHED_BLOCK = 1 << 14
"""With hashed grouping `PacketId.lane` is a position within the block, and the header has 14 bits for it."""
MIN_PACKET_BYTES = 128
MAX_DATAGRAM_BYTES = 65_507
DATAGRAM_BYTES = 1150
"""A datagram of 1200 bytes passes every path (RFC 9000, 14); up to 50 of them are for the layers around a packet."""
MAX_GROUPS = (1 << 31) - 1


def _check_range(what: str, value: int, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise InvalidValueError(f"{what} must be an integer from {low} to {high}, not {value!r}")


@dataclass(frozen=True)
class Packetization:
    """How anchors are split into packets (paper 3.2.2 and 4.1, "Packetization Parameters").

    Attributes:
        block_size: Most anchors of a spatial block.
        lanes: Packets that a block is split into.
        seed: Seed of the lane hash, 64 bits.
        order: How anchors are ranked: `morton` (true Z-order) or `raster` (z-major, what HAC++ does).
        grouping: `stratified` (hashed lanes), `contiguous` (each lane a run of consecutive ranks) or `hashed` (the
            block's anchors in the order of their hashes, as many to a packet as its bytes allow; `lanes` is 1).
        packaging: `atomic` (a packet holds whole anchors) or `separated` (one packet per attribute, as in HAC++; the
            baseline of the ablation).
        packet_bytes: With hashed grouping the most bytes of a packet, header included; 0 with every other.

    Raises:
        UnknownNameError: If order, grouping or packaging is not one of the above.
        InvalidValueError: If a number is out of range.
    """

    block_size: int = 3000
    lanes: int = 8
    seed: int = 1337
    order: str = "morton"
    grouping: str = "stratified"
    packaging: str = "atomic"
    packet_bytes: int = 0

    def __post_init__(self) -> None:
        _check_range("block size", self.block_size, 1, MAX_BLOCK_SIZE)
        _check_range("number of lanes", self.lanes, 1, MAX_LANES)
        _check_range("packetization seed", self.seed, 0, (1 << 64) - 1)
        for kind, name, known in (
            ("order", self.order, ORDERS),
            ("grouping", self.grouping, GROUPINGS),
            ("packaging", self.packaging, tuple(PACKAGING_PARTS)),
        ):
            if name not in known:
                raise UnknownNameError(kind, str(name), known)
        self._check_hashed()

    def _check_hashed(self) -> None:
        if not self.hashed:
            _check_range(f"packet size with {self.grouping} grouping", self.packet_bytes, 0, 0)
            return
        _check_range("packet size with hashed grouping", self.packet_bytes, MIN_PACKET_BYTES, MAX_DATAGRAM_BYTES)
        _check_range("block size with hashed grouping", self.block_size, 1, MAX_HASHED_BLOCK)
        _check_range("number of lanes with hashed grouping", self.lanes, 1, 1)
        if self.packaging != "atomic":
            raise InvalidValueError("hashed grouping knows atomic packaging only")

    @property
    def hashed(self) -> bool:
        """Whether packets are cut by their size, so that only a packet itself says which anchors it holds."""
        return self.grouping == "hashed"

    @property
    def unit(self) -> str:
        """What a loss of one packet is called: `datagram` if packets are cut to fit one, else `pak`."""
        return "datagram" if self.hashed else "pak"

    @property
    def parts(self) -> tuple[int, ...]:
        """`PacketId.part` of the packets that one block and lane are split into."""
        return PACKAGING_PARTS[self.packaging]


PRESETS = {
    "paper": Packetization(),
    "hacpp": Packetization(lanes=1, order="raster", grouping="contiguous", packaging="separated"),
    "datagram": Packetization(lanes=1, grouping="hashed", packet_bytes=DATAGRAM_BYTES),
}
"""Named packetizations: the paper's, the baseline it is measured against, and packets that fit a datagram."""


@dataclass(frozen=True, order=True)
class PacketId:
    """Name of a packet within its stream; sorts by block, then lane, then part.

    Attributes:
        block: Spatial block, t.
        lane: Lane within the block, λ; with hashed grouping, position of its first anchor in the block's hash order.
        part: What it carries of its anchors, an index into `PARTS`.
    """

    block: int
    lane: int
    part: int = 0

    @property
    def filename(self) -> str:
        """File name of the packet in a stream directory: `pak_lane{lane}_s{block}.pak` for whole anchors."""
        suffix = f"_{PARTS[self.part]}" if self.part else ""
        return f"pak_lane{self.lane}_s{self.block}{suffix}.pak"

    @classmethod
    def from_filename(cls, name: str) -> "PacketId":
        """Reads a file name back.

        Raises:
            InvalidValueError: If it is not exactly a name that `filename` gives.
        """
        match = _FILENAME.fullmatch(name)
        if match is None:
            raise InvalidValueError(f"'{name}' is not a packet name such as pak_lane3_s0.pak")
        return cls(int(match["block"]), int(match["lane"]), PARTS.index(match["part"] or PARTS[0]))


_FILENAME = re.compile(
    rf"pak_lane(?P<lane>0|[1-9][0-9]{{0,4}})_s(?P<block>0|[1-9][0-9]{{0,7}})(?:_(?P<part>{'|'.join(PARTS[1:])}))?\.pak",
    re.ASCII,
)


class PacketGroups(NamedTuple):
    """Anchors by block and lane, in compressed rows: group g holds `ranks[starts[g]:starts[g + 1]]`, ascending.

    Attributes:
        ranks: All ranks, group after group, int64, N.
        starts: Bounds of the groups, int64, G + 1. Empty groups are left out; with atomic packaging, group g is the
            packet `PacketPlan.ids[g]`; otherwise it is the `len(parts)` packets from `ids[g * len(parts)]` on.
    """

    ranks: np.ndarray
    starts: np.ndarray


@dataclass(frozen=True)
class PacketPlan:
    """Mapping between ranks and packets, rebuilt from two things alone; constructing it computes nothing.

    Attributes:
        packetization: How anchors are split.
        num_anchors: Anchors of the scene, N.

    Raises:
        InvalidValueError: If the scene is larger than the format holds.
    """

    packetization: Packetization
    num_anchors: int

    def __post_init__(self) -> None:
        _check_range("number of anchors", self.num_anchors, 0, MAX_ANCHORS)
        _check_range("number of blocks", self.num_blocks, 0, MAX_BLOCKS)
        _check_range("number of packets", self.num_blocks * self.packetization.lanes, 0, MAX_GROUPS)

    @property
    def num_blocks(self) -> int:
        """Spatial blocks, S."""
        return -(-self.num_anchors // self.packetization.block_size)

    @functools.cached_property
    def ids(self) -> tuple[PacketId, ...]:
        """All packets that hold an anchor, in the order j = block * lanes + lane (then part).

        Raises:
            InvalidValueError: With hashed grouping, where only a stream knows.
        """
        self._check_fixed()
        lanes, parts = self.packetization.lanes, self.packetization.parts
        used = np.flatnonzero(self._counts()).tolist()
        return tuple(PacketId(j // lanes, j % lanes, part) for j in used for part in parts)

    def packet_index_of(self) -> np.ndarray:
        """Packet index j = block * lanes + lane of every rank, int32, N; not with hashed grouping."""
        self._check_fixed()
        p = self.packetization
        block = np.arange(self.num_anchors, dtype=np.int32) // np.int32(p.block_size)
        if p.grouping == "stratified":
            lane = stratified_lanes(0, self.num_anchors, p.lanes, p.seed)
        else:
            full = contiguous_lanes(p.block_size, p.lanes)
            num_full, rest = divmod(self.num_anchors, p.block_size)
            lane = np.concatenate([np.tile(full, num_full), contiguous_lanes(rest, p.lanes)])
        return block * np.int32(p.lanes) + lane

    def groups(self) -> PacketGroups:
        """Ranks of all packets at once; with hashed grouping of all blocks, each in the order of its hashes."""
        if self.packetization.hashed:
            edges = np.minimum(np.arange(self.num_blocks + 1) * self.packetization.block_size, self.num_anchors)
            blocks = [self._hash_order(block) for block in range(self.num_blocks)]
            return PacketGroups(np.concatenate([np.empty(0, np.int64), *blocks]), edges.astype(np.int64))
        counts = self._counts()
        ranks = np.argsort(self.packet_index_of(), kind="stable")
        return PacketGroups(ranks, np.concatenate([[0], np.cumsum(counts[counts > 0])]).astype(np.int64))

    def members(self, packet_id: PacketId, num_anchors: int | None = None) -> np.ndarray:
        """Ranks of one packet's anchors, ascending (hashed: in hash order), int64; computed from its block alone.

        Args:
            packet_id: The packet.
            num_anchors: Its number of anchors, which with hashed grouping only the packet knows.

        Raises:
            InvalidValueError: If the plan has no such block, lane or part, or not so many anchors.
        """
        if num_anchors is None and not self.packetization.hashed:
            start, lanes = self._block_lanes(packet_id)
            return start + np.flatnonzero(lanes == packet_id.lane)
        if num_anchors is None or not self.fits(packet_id, num_anchors):
            raise InvalidValueError(f"the plan has no packet {packet_id.filename} with {num_anchors} anchors")
        if not self.packetization.hashed:
            return self.members(packet_id)
        return self._hash_order(packet_id.block)[packet_id.lane : packet_id.lane + num_anchors]

    def count(self, packet_id: PacketId) -> int:
        """Anchors of one packet; 0 if the plan has no such packet. Cheap: at most one block is hashed.

        With hashed grouping, the anchors from the packet's first position to its block's end: the most it can hold.
        """
        p = self.packetization
        if not (0 <= packet_id.block < self.num_blocks and packet_id.lane >= 0 and packet_id.part in p.parts):
            return 0
        if p.hashed:
            return max(0, self.block_anchors(packet_id.block) - packet_id.lane)
        if packet_id.lane >= p.lanes:
            return 0
        return int(_lane_counts(p, self.num_anchors, packet_id.block)[packet_id.lane])

    def fits(self, packet_id: PacketId, num_anchors: int) -> bool:
        """Whether the plan has such a packet with so many anchors."""
        count = self.count(packet_id)
        return 1 <= num_anchors <= count if self.packetization.hashed else num_anchors == count > 0

    def block_anchors(self, block: int) -> int:
        """Anchors of a block."""
        return min(self.packetization.block_size, self.num_anchors - block * self.packetization.block_size)

    def _hash_order(self, block: int) -> np.ndarray:
        start = block * self.packetization.block_size
        return hash_order(start, start + self.block_anchors(block), self.packetization.seed)

    def _check_fixed(self) -> None:
        if self.packetization.hashed:
            raise InvalidValueError("packets of hashed grouping are cut by their size: a plan does not know them")

    def _block_lanes(self, packet_id: PacketId) -> tuple[int, np.ndarray]:
        """First rank of a packet's block, and the lane of each of the block's ranks."""
        p = self.packetization
        _check_range("block", packet_id.block, 0, self.num_blocks - 1)
        _check_range("lane", packet_id.lane, 0, p.lanes - 1)
        if packet_id.part not in p.parts:
            raise InvalidValueError(f"{p.packaging} packaging has no packet {packet_id.filename}")
        start = packet_id.block * p.block_size
        stop = min(start + p.block_size, self.num_anchors)
        if p.grouping == "stratified":
            return start, stratified_lanes(start, stop, p.lanes, p.seed)
        return start, contiguous_lanes(stop - start, p.lanes)

    def _counts(self) -> np.ndarray:
        """Anchors of each (block, lane), empty ones too, int64, S * lanes."""
        p = self.packetization
        if p.grouping == "stratified":
            return np.bincount(self.packet_index_of(), minlength=self.num_blocks * p.lanes)
        full = np.diff(contiguous_bounds(p.block_size, p.lanes))
        num_full, rest = divmod(self.num_anchors, p.block_size)
        last = [np.diff(contiguous_bounds(rest, p.lanes))] if rest else []
        return np.concatenate([np.tile(full, num_full), *last])


@functools.lru_cache(maxsize=2048)
def _lane_counts(packetization: Packetization, num_anchors: int, block: int) -> np.ndarray:
    """Anchors in each lane of a block; remembered because the packets of a block are asked for one after another."""
    first = PacketId(block, 0, packetization.parts[0])
    _, lanes = PacketPlan(packetization, num_anchors)._block_lanes(first)
    return np.bincount(lanes, minlength=packetization.lanes)
