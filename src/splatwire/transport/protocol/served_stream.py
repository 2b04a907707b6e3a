"""Streams prepared for sending: symbols, parity and sending order, shared by all clients."""

import functools
import hashlib
import math
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import Packet, PacketId, SceneStream, send_sequence
from splatwire.bitstream.tiles import Tiles, read_tiles
from splatwire.errors import InvalidValueError
from splatwire.reprs import summary_repr
from splatwire.transport.fec import ALIGNMENT, MAX_REPAIR, framed, repair_symbols, source_symbols, symbol_bytes_for
from splatwire.transport.protocol.layout import ParityGroup, SourceBlocks, init_segment, parity_groups
from splatwire.transport.protocol.messages import MAX_PREVIEW, ParityRange
from splatwire.transport.protocol.motion_parity import group_packets, order_and_protect
from splatwire.transport.protocol.protection import (
    MAX_INIT_SYMBOL_BYTES,
    Protection,
    num_bundled_packets,
    packets_in_tiers,
    protected_tiers,
)
from splatwire.transport.protocol.send_schedule import ScheduledDatagram, build_send_schedule
from splatwire.transport.protocol.wire import (
    DATA,
    DATA_OVERHEAD,
    INIT_SYMBOL,
    INIT_SYMBOL_OVERHEAD,
    PARITY,
    PARITY_OVERHEAD,
)

MAX_PACKET_BYTES = 1150
MIN_DEFAULT_SYMBOL_BYTES = 256
"""Minimum of the default symbol size in bytes: with smaller symbols, additional headers cost more than fewer repair
symbols save.
"""
RESERVE_SHARE = 0.5
"""Number of repair symbols of the init segment that are sent only after NACKs, as a share of its source symbols."""
OPENING_BYTES = 1 << 18
"""Maximum size in bytes of the coarsest tiles that are sent before view-dependent tiles. The coarsest tiles show the
whole scene and conceal losses.
"""
MIN_SYMBOLS = 600
"""Minimum number of symbols of an init segment, if symbols need not be smaller than `MIN_DEFAULT_SYMBOL_BYTES` for it.
The lost share of many symbols varies less, so that fewer repair symbols are needed.
"""


class SendSchedule(NamedTuple):
    """Datagrams of a stream in sending order.

    Attributes:
        datagrams: The datagrams.
        init_segment_end: Number of datagrams up to the end of the init segment.
        opening_end: Number of datagrams that are sent before the order depends on the viewpoint; 0 without tiles.
    """

    datagrams: Sequence[ScheduledDatagram]
    init_segment_end: int
    opening_end: int


class AddedDatagrams(NamedTuple):
    """Datagrams that a new state of a live stream adds to the queue of a client.

    Attributes:
        init_segment: Symbols of the new init segment.
        packets: New packets, and repair symbols.
    """

    init_segment: tuple[ScheduledDatagram, ...]
    packets: tuple[ScheduledDatagram, ...]


@dataclass(frozen=True, eq=False)
class ServedStream:
    """Stream prepared for sending; immutable, and shared by all clients.

    Attributes:
        stream_id: Id of the stream, contained in every packet.
        init_segment_bytes: Size of the init segment (manifest, side information, bundled packets) in bytes.
        init_segment_digest: SHA-256 of the init segment.
        symbol_bytes: Size of the init segment's symbols (erasure code) in bytes.
        init_symbols: For each source block (separately encoded part) of the init segment, its source symbols and repair
            symbols. Some of the repair symbols are only sent on request.
        packets: Packets in sending order.
        max_packet_bytes: Maximum size of a packet in bytes.
        num_bundled: Number of packets at the start of the sending order that are bundled in the init segment.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
        parity: Repair symbols of each parity group (packets that share repair symbols).
        schedule: Datagrams in sending order, for a client that joins now. Clients that joined a live stream earlier get
            `added_datagrams`.
        preview: Encoded preview, which clients get first; empty without a preview.
        retransmit_share: Maximum retransmitted bytes as a share of the bytes of the complete stream; None for no limit.
        retransmit_limit: Number of packets at the start of the sending order that may be retransmitted; None for all.
        tiles: Tiles of a stream with levels of detail, else None.
        opening_packets: Number of packets of the coarsest tiles, which are sent first for every viewpoint.
        is_live: True for a live stream that may still grow; False in the final state of one.
    """

    stream_id: int
    init_segment_bytes: int
    init_segment_digest: bytes
    symbol_bytes: int
    init_symbols: tuple[tuple[bytes, ...], ...]
    packets: tuple[bytes, ...]
    max_packet_bytes: int
    num_bundled: int
    parity_ranges: tuple[ParityRange, ...]
    parity: tuple[tuple[bytes, ...], ...]
    schedule: tuple[ScheduledDatagram, ...]
    preview: bytes = b""
    retransmit_share: float | None = None
    retransmit_limit: int | None = None
    tiles: Tiles | None = None
    opening_packets: int = 0
    is_live: bool = False

    __repr__ = summary_repr

    @property
    def packet_bytes(self) -> int:
        """Deprecated name of `max_packet_bytes`."""
        warnings.warn("ServedStream.packet_bytes is deprecated, use max_packet_bytes", DeprecationWarning, stacklevel=2)
        return self.max_packet_bytes

    @functools.cached_property
    def send_schedule(self) -> SendSchedule:
        """Sending order for UDP clients."""
        return self.schedule_of(self.schedule)

    @functools.cached_property
    def reliable_schedule(self) -> SendSchedule:
        """Sending order for QUIC clients.

        The source symbols of the init segment come first, because they are sent on a reliable QUIC stream. Packets and
        their repair symbols follow in the same order as for UDP clients. Repair symbols of the init segment are left
        out, because the reliable stream needs none.
        """
        source_blocks = SourceBlocks(self.init_segment_bytes, self.symbol_bytes)
        source_symbols = (
            (kind, block, symbol) for kind, block, symbol in self.schedule
            if kind == INIT_SYMBOL and symbol < source_blocks.size(block)
        )  # fmt: skip
        others = (item for item in self.schedule if item[0] != INIT_SYMBOL)
        return self.schedule_of((*source_symbols, *others))

    def schedule_of(self, datagrams: Sequence[ScheduledDatagram]) -> SendSchedule:
        """Builds a schedule from datagrams in sending order.

        Args:
            datagrams: The datagrams.
        """
        init_segment_end = opening_end = 0
        for number, item in enumerate(datagrams):
            kind, _, _ = item
            if kind == INIT_SYMBOL:
                init_segment_end = number + 1
            if self.tiles is not None and self.in_opening(item):
                opening_end = number + 1
        return SendSchedule(datagrams, init_segment_end, opening_end)

    def in_opening(self, item: ScheduledDatagram) -> bool:
        """True if a datagram belongs to the start of a transfer, which is the same for every viewpoint.

        Args:
            item: The datagram.
        """
        kind, group, index = item
        if kind == PARITY:
            parity_group = self.parity_groups[group]
            return parity_group.packet_of(parity_group.size - 1) < self.opening_packets
        return kind == INIT_SYMBOL or (kind == DATA and index < self.opening_packets)

    @functools.cached_property
    def parity_groups(self) -> list[ParityGroup]:
        """Parity groups (packets that share repair symbols), in sending order."""
        return parity_groups(self.parity_ranges)

    @functools.cached_property
    def num_proactive_symbols(self) -> int:
        """Number of symbols of a source block of the init segment that every client gets without requesting them.

        A source block is a part of the init segment that is coded separately by the erasure code. Source symbols and
        repair symbols are counted. If the numbers differ between source blocks, the smallest one is returned.
        """
        counts = Counter(source_block for kind, source_block, _ in self.schedule if kind == INIT_SYMBOL)
        # The smallest number, if it differs between source blocks. Further symbols are only sent after NACKs.
        return min(counts.values())

    @functools.cached_property
    def max_retransmitted_bytes(self) -> float:
        """Maximum number of retransmitted bytes per client; infinite without a limit."""
        return math.inf if self.retransmit_share is None else self.retransmit_share * sum(self.sizes().values())

    @property
    def limits_retransmission(self) -> bool:
        """True if retransmission of this stream is limited, so that the server must count retransmitted bytes."""
        return self.retransmit_share is not None or self.num_retransmittable < len(self.packets)

    @functools.cached_property
    def num_retransmittable(self) -> int:
        """Number of packets at the start of the sending order that may be retransmitted."""
        return len(self.packets) if self.retransmit_limit is None else self.retransmit_limit

    def may_retransmit(self, index: int) -> bool:
        """Returns True if the packet with a given index in sending order may be retransmitted."""
        return index < self.num_retransmittable and self.is_still_needed(index)

    def is_still_needed(self, index: int) -> bool:
        """Returns True if clients still need the packet with a given index in sending order.

        Other packets are not retransmitted, and `still_useful` removes them from queues.
        """
        return index < len(self.packets)

    def still_useful(self, items: Sequence[ScheduledDatagram]) -> list[ScheduledDatagram]:
        """Returns the datagrams that were queued in an earlier state of the stream and are still useful.

        Args:
            items: Datagrams. Only packets and repair symbols can be useful.
        """
        is_needed, num_packets, num_repair = self._needed_flags, len(self.packets), [*map(len, self.parity)]
        return [
            item
            for item in items
            for kind, group, index in (item,)
            if (kind == DATA and index < num_packets and is_needed[index])
            or (kind == PARITY and group < len(num_repair) and index < num_repair[group])
        ]

    @functools.cached_property
    def _needed_flags(self) -> bytes:
        """One number per packet: 1 if clients still need the packet, else 0."""
        return bytes(map(self.is_still_needed, range(len(self.packets))))

    @functools.cached_property
    def _added_datagrams(self) -> dict[tuple[bool, int], "AddedDatagrams"]:
        return {}

    def added_datagrams(self, num_packets_before: int, *, reliable: bool) -> "AddedDatagrams":
        """Returns the datagrams that this state of a live stream adds to a queue; computed once for all clients.

        Args:
            num_packets_before: Number of packets of the stream's previous state, sent or not; 0 if there was none.
            reliable: True if the init segment is sent on a reliable (QUIC) stream.
        """
        key = reliable, num_packets_before
        if key not in self._added_datagrams:
            datagrams = (self.reliable_schedule if reliable else self.send_schedule).datagrams
            init_symbols = tuple(item for item in datagrams if item[0] == INIT_SYMBOL)
            new = () if num_packets_before == len(self.packets) else tuple(
                item for item in datagrams for kind, _, index in (item,)
                if kind == PARITY or (kind == DATA and index >= num_packets_before)
            )  # fmt: skip
            self._added_datagrams[key] = AddedDatagrams(init_symbols, new)
        return self._added_datagrams[key]

    @property
    def view_dependent(self) -> bool:
        """True if the sending order depends on the client's viewpoint."""
        return self.tiles is not None

    def sizes(self) -> dict[str, int]:
        """Returns the bytes to send for the init segment, the packets, and the repair symbols of both.

        Keys: `init_segment`, `init_protection`, `packets`, `packet_protection`. Headers of UDP and IP do not count.
        """
        return dict(self._sizes)

    @functools.cached_property
    def _sizes(self) -> dict[str, int]:
        source_blocks = SourceBlocks(self.init_segment_bytes, self.symbol_bytes)
        bytes_per_symbol, num_source = self.symbol_bytes + INIT_SYMBOL_OVERHEAD, source_blocks.num_symbols
        num_repair = sum(1 for kind, _, _ in self.schedule if kind == INIT_SYMBOL) - num_source
        parity_bytes = sum(len(symbol) + PARITY_OVERHEAD for group in self.parity for symbol in group)
        return {
            "init_segment": num_source * bytes_per_symbol,
            "init_protection": num_repair * bytes_per_symbol,
            "packets": self._bytes_from(self.num_bundled),
            "packet_protection": parity_bytes,
        }

    def _bytes_from(self, first: int) -> int:
        """Returns the bytes to send for all packets from index `first` in sending order on."""
        return sum(DATA_OVERHEAD + len(packet) for packet in self.packets[first:])

    def num_added_bytes(self, num_packets_before: int) -> int:
        """Returns the bytes that this state of a live stream adds for a client, protection included.

        Args:
            num_packets_before: Number of packets of the stream's previous state, sent or not; 0 if there was none.
        """
        sizes = self._sizes
        packets = sizes["packets"] if num_packets_before <= self.num_bundled else self._bytes_from(num_packets_before)
        return sum(sizes.values()) - sizes["packets"] + packets


@checked
def make_served_stream(
    stream: SceneStream, protection: Protection | None = None, *, preview: bytes = b"",
    importance: Mapping[PacketId, float] | None = None,
) -> ServedStream:  # fmt: skip
    """Prepares a stream for sending.

    Args:
        stream: Complete stream; each packet must fit a datagram.
        protection: Redundancy; None for the default.
        preview: Encoded preview, which clients get first; may be empty.
        importance: For a sequence: cost of losing each motion packet, by packet id. None for equal costs.

    Raises:
        InvalidValueError: If packets are missing, or a packet or the preview is too large for a datagram.
        BackendUnavailableError: If parity is requested and the package `raptorq` is not installed.
    """
    manifest, protection = stream.manifest, protection or Protection()
    tiles = read_tiles(manifest, stream.side_info) if manifest.schema.tiled else None
    if tiles is not None and not protection.tier_repair:  # without the coarsest tile nothing is drawn
        protection = replace(protection, tier_repair=(protection.init_repair,))
    if len(stream.packets) != manifest.num_packets:
        raise InvalidValueError(
            f"{len(stream.packets)} of {manifest.num_packets} packets: only a complete stream is served"
        )
    if len(preview) > MAX_PREVIEW:
        raise InvalidValueError(f"a preview of {len(preview):,} bytes: a welcome carries at most {MAX_PREVIEW}")
    ordered, ranges = _packets_in_order(stream, protection, importance)
    packets = tuple(packet.data for packet in ordered)
    largest = max(map(len, packets), default=0)
    if largest > MAX_PACKET_BYTES:
        raise InvalidValueError(
            f"a packet of {largest} bytes fits no datagram (at most {MAX_PACKET_BYTES}): encode with --preset datagram"
        )
    num_bundled = num_bundled_packets(len(packets), protection)
    data = init_segment(manifest, stream.side_info, packets[:num_bundled])
    symbol_bytes = protection.init_symbol_bytes or default_symbol_bytes(len(data))
    init_symbols, num_init_symbols = encode_init_segment(data, symbol_bytes, protection)
    tiers = [manifest.plan.tier_of(packet.id.block) for packet in ordered]
    timing = replace(protection, parity_until=0.0) if protection.motion else protection
    parity = parity_symbols(packets, ranges, symbol_bytes_for(largest))
    tier_packets = packets_in_tiers(tiers, protection)
    schedule = build_send_schedule(num_init_symbols, ranges, [*map(len, parity)], timing, tier_packets)
    served = ServedStream(
        manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, init_symbols, packets, largest,
        num_bundled, ranges, parity, schedule,
        preview, protection.retransmit_share, round(protection.retransmit_until * len(packets)),
    )  # fmt: skip
    return served if tiles is None else _with_view_order(served, tiles)


def _with_view_order(stream: ServedStream, tiles: Tiles) -> ServedStream:
    """Prepares a stream with levels of detail for sending in an order that depends on the client's viewpoint."""
    num_tiles = max(1, int(np.searchsorted(np.cumsum(tiles.sizes), OPENING_BYTES, "right")))
    stream = replace(stream, opening_packets=max(int(tiles.first_packets[num_tiles]), stream.num_bundled))
    opening = tuple(filter(stream.in_opening, stream.schedule))
    rest = tuple(item for item in stream.schedule if not stream.in_opening(item))
    return replace(stream, schedule=opening + rest, tiles=tiles)


def _packets_in_order(
    stream: SceneStream, protection: Protection, importance: Mapping[PacketId, float] | None
) -> tuple[list[Packet], tuple[ParityRange, ...]]:
    """Sorts the packets of a stream into sending order, and determines the parity of ranges of packets.

    Args:
        stream: Complete stream.
        protection: Redundancy.
        importance: Cost of losing each motion packet of a sequence, by packet id; None for equal costs.

    Raises:
        InvalidValueError: If parity for motion is combined with parity for importance tiers, or the stream is not a
            sequence.
    """
    ordered, plan = send_sequence(stream, "tiers"), stream.manifest.plan
    if not protection.motion:
        return ordered, protected_tiers([plan.tier_of(packet.id.block) for packet in ordered], protection)
    if not stream.manifest.schema.timed or protection.tier_repair or protection.tier_spread:
        raise InvalidValueError("parity for the motion of groups of frames is for a clip, and excludes that for tiers")
    costs = None if importance is None else [importance.get(packet.id, 0.0) for packet in ordered]
    protected = order_and_protect(group_packets(ordered, plan), costs, protection)
    return [ordered[index] for index in protected.order], protected.parity_ranges


def default_symbol_bytes(num_bytes: int) -> int:
    """Returns the default size of FEC symbols for an init segment of `num_bytes` bytes."""
    symbol_bytes = num_bytes // MIN_SYMBOLS // ALIGNMENT * ALIGNMENT
    return min(max(symbol_bytes, MIN_DEFAULT_SYMBOL_BYTES), MAX_INIT_SYMBOL_BYTES)


def encode_init_segment(
    data: bytes, symbol_bytes: int, protection: Protection
) -> tuple[tuple[tuple[bytes, ...], ...], list[int]]:
    """Encodes an init segment into source and repair symbols.

    Args:
        data: Bytes of the init segment.
        symbol_bytes: Size of a symbol in bytes.
        protection: Redundancy.

    Returns:
        Two lists with an entry for each source block (part of the init segment that is coded separately). The first has
        the source symbols of the block, followed by its repair symbols. The second has the number of these symbols that
        every client gets. The other symbols are a reserve.
    """
    source_blocks = SourceBlocks(len(data), symbol_bytes)
    symbols, num_scheduled = [], []
    for source_block in range(source_blocks.num_blocks):
        block_data = data[source_blocks.span(source_block)]
        num_source = source_blocks.size(source_block)
        num_proactive_repair = min(round(protection.init_repair * num_source), MAX_REPAIR)
        has_repair = num_proactive_repair > 0 or protection.limits_retransmission
        num_repair = min(num_proactive_repair + math.ceil(RESERVE_SHARE * num_source), MAX_REPAIR) if has_repair else 0
        symbols.append((
            *source_symbols(block_data, symbol_bytes), *repair_symbols(block_data, symbol_bytes, num_repair)
        ))  # fmt: skip
        num_scheduled.append(num_source + num_proactive_repair)
    return tuple(symbols), num_scheduled


def parity_symbols(
    packets: Sequence[bytes], parity_ranges: Sequence[ParityRange], symbol_bytes: int
) -> tuple[tuple[bytes, ...], ...]:
    """Computes the repair symbols of each parity group.

    Args:
        packets: Packets in sending order.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
        symbol_bytes: Size of a symbol in bytes.
    """
    out = []
    for group in parity_groups(parity_ranges):
        members = [packets[group.packet_of(n)] for n in range(group.size)]
        out.append(tuple(repair_symbols(framed(members, symbol_bytes), symbol_bytes, group.repair)))
    return tuple(out)
