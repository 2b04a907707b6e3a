"""What a server sends of a stream, in which order: computed once, shared by all clients, never changed."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from splatwire.errors import InvalidValueError
from splatwire.packets import Packet, SceneStream, packet_to_bytes
from splatwire.transport.fec import (
    ALIGNMENT,
    MAX_REPAIR,
    MAX_SYMBOLS,
    framed,
    framed_bytes,
    num_symbols,
    repair_symbols,
    source_symbols,
)
from splatwire.transport.layout import Segments, head_object, parity_groups
from splatwire.transport.wire import (
    DATA,
    DATA_OVERHEAD,
    MAX_DATAGRAM,
    MAX_TIERS,
    PARITY,
    PARITY_OVERHEAD,
    SIDE,
    SIDE_OVERHEAD,
    TierHead,
)

MAX_PACKET_BYTES = 1150
SIDE_SYMBOL_BYTES = (MAX_DATAGRAM - SIDE_OVERHEAD) // ALIGNMENT * ALIGNMENT - 32
MIN_SYMBOL_BYTES = 256
SMALL_OBJECT_SYMBOLS = 600
"""A small head object is cut finer: the share of many symbols that is lost varies less than that of few."""


@dataclass(frozen=True)
class Tier:
    """Protection of a share of the packets.

    Attributes:
        share: Of all packets, 0 to 1, in sending order.
        repair: Repair symbols for each packet, 0 to 2.
    """

    share: float
    repair: float


@dataclass(frozen=True)
class Protection:
    """Where redundancy goes.

    Attributes:
        side_repair: Repair symbols of manifest and side information for each symbol, 0 to 2. With a way back they are
            sent again on request anyway.
        side_lead: Symbols of the head object are sent between this first share of the packets, 0 to 1: small shows
            something soon, large survives longer bursts.
        tiers: Protection of the packets by importance; what the shares leave over has no parity.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    side_repair: float = 0.35
    side_lead: float = 0.4
    tiers: tuple[Tier, ...] = ()

    def __post_init__(self) -> None:
        checks = [("side_repair", self.side_repair, 2.0), ("side_lead", self.side_lead, 1.0)]
        for tier in self.tiers:
            checks += [("share of a tier", tier.share, 1.0), ("repair of a tier", tier.repair, 2.0)]
        for name, value, high in checks:
            if not 0.0 <= value <= high:
                raise InvalidValueError(f"{name} must be from 0 to {high}, not {value}")
        if sum(tier.share for tier in self.tiers) > 1 + 1e-9 or len(self.tiers) >= MAX_TIERS:
            raise InvalidValueError("the tiers' shares add up to more than 1, or there are too many tiers")


@dataclass(frozen=True, eq=False)
class Program:
    """All that may be sent of a stream.

    Attributes:
        stream_id: Id that every packet carries.
        head_bytes: Size of the head object.
        head_digest: SHA-256 of the head object.
        symbol_bytes: Size of its symbols.
        head: Symbols of each segment, source and repair.
        packets: Packets in sending order, as bytes.
        packet_bytes: Most bytes of one.
        tiers: Protection of the packets.
        parity: Repair symbols of each group.
        schedule: What is sent once, in order: kind, segment or group (0 for a packet), symbol or index.
    """

    stream_id: int
    head_bytes: int
    head_digest: bytes
    symbol_bytes: int
    head: tuple[tuple[bytes, ...], ...]
    packets: tuple[bytes, ...]
    packet_bytes: int
    tiers: tuple[TierHead, ...]
    parity: tuple[tuple[bytes, ...], ...]
    schedule: tuple[tuple[int, int, int], ...]

    def sizes(self) -> dict[str, int]:
        """Bytes of one complete pass, by what they are for; headers of datagrams (not of UDP and IP) included."""
        segments = Segments(self.head_bytes, self.symbol_bytes)
        per_symbol, source = self.symbol_bytes + SIDE_OVERHEAD, segments.num_symbols
        repair = sum(1 for kind, _, _ in self.schedule if kind == SIDE) - source
        parity = sum(len(symbol) + PARITY_OVERHEAD for group in self.parity for symbol in group)
        return {
            "side": source * per_symbol,
            "side_protection": repair * per_symbol,
            "packets": sum(map(len, self.packets)) + DATA_OVERHEAD * len(self.packets),
            "packet_protection": parity,
        }


def make_program(
    stream: SceneStream, protection: Protection | None = None, *, order: Sequence[Packet] | None = None
) -> Program:
    """Prepares a stream for sending.

    Args:
        stream: The complete stream; its packets must fit datagrams.
        protection: Where redundancy goes.
        order: Its packets in sending order; None interleaves blocks and lanes.

    Raises:
        InvalidValueError: If packets are missing or too large for a datagram.
        BackendUnavailableError: If parity is asked for and the package `raptorq` is not installed.
    """
    protection = protection or Protection()
    manifest = stream.manifest
    if len(stream.packets) != manifest.num_packets:
        raise InvalidValueError(
            f"{len(stream.packets)} of {manifest.num_packets} packets: only a complete stream is served"
        )
    ordered = list(order) if order is not None else interleaved(stream.packets)
    packets = tuple(packet_to_bytes(packet, manifest.stream_id) for packet in ordered)
    largest = max(map(len, packets), default=0)
    if largest > MAX_PACKET_BYTES:
        raise InvalidValueError(
            f"a packet of {largest} bytes fits no datagram (at most {MAX_PACKET_BYTES}): encode with --preset datagram"
        )
    data = head_object(manifest, stream.side_info)
    symbol_bytes = side_symbol_bytes(len(data))
    head = _head_symbols(data, symbol_bytes, protection.side_repair)
    tiers = _tier_heads(protection, len(packets))
    parity = _parity(packets, tiers, framed_bytes(largest))
    return Program(
        manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, head, packets, largest, tiers,
        parity, _schedule(head, len(packets), parity, protection.side_lead),
    )  # fmt: skip


def interleaved(packets: Sequence[Packet]) -> list[Packet]:
    """Sending order: lane by lane (or by hash position) over all blocks, so that a burst hits many blocks."""
    return sorted(packets, key=lambda packet: (packet.id.lane, packet.id.part, packet.id.block))


def side_symbol_bytes(num_bytes: int) -> int:
    """Size of the symbols of a head object."""
    finer = num_bytes // SMALL_OBJECT_SYMBOLS // ALIGNMENT * ALIGNMENT
    return min(max(finer, MIN_SYMBOL_BYTES), SIDE_SYMBOL_BYTES)


def _head_symbols(data: bytes, symbol_bytes: int, share: float) -> tuple[tuple[bytes, ...], ...]:
    segments = Segments(len(data), symbol_bytes)
    out = []
    for segment in range(segments.num_segments):
        piece = data[segments.span(segment)]
        repair = min(round(share * segments.size(segment)), MAX_REPAIR)
        out.append((*source_symbols(piece, symbol_bytes), *repair_symbols(piece, symbol_bytes, repair)))
    return tuple(out)


def _tier_heads(protection: Protection, num_packets: int) -> tuple[TierHead, ...]:
    heads, first, share = [], 0, 0.0
    for tier in protection.tiers:
        share += tier.share
        size = round(share * num_packets) - first
        groups = -(-size // MAX_SYMBOLS) if tier.repair else 0
        repair = min(round(tier.repair * num_symbols(size, groups)), MAX_REPAIR) if groups else 0
        if size:
            heads.append(TierHead(size, groups if repair else 0, repair))
            first += size
    if first < num_packets or not heads:
        heads.append(TierHead(num_packets - first, 0, 0))
    return tuple(heads)


def _parity(
    packets: tuple[bytes, ...], tiers: tuple[TierHead, ...], symbol_bytes: int
) -> tuple[tuple[bytes, ...], ...]:
    out = []
    for group in parity_groups(tiers):
        members = [packets[group.packet_of(n)] for n in range(group.size)]
        out.append(tuple(repair_symbols(framed(members, symbol_bytes), symbol_bytes, group.repair)))
    return tuple(out)


def _schedule(
    head: tuple[tuple[bytes, ...], ...], num_packets: int, parity: tuple[tuple[bytes, ...], ...], lead: float
) -> tuple[tuple[int, int, int], ...]:
    """Spreads the head object over the first share of the packets, and parity over the second half.

    Each datagram has a due time from 0 to 1; symbols of different segments and groups take turns.
    """
    head_items = sorted(((n / len(s), k, n) for k, s in enumerate(head) for n in range(len(s))))
    parity_items = sorted(((n / len(s), k, n) for k, s in enumerate(parity) for n in range(len(s))))
    due = [((n + 0.5) / len(head_items) * lead, SIDE, k, i) for n, (_, k, i) in enumerate(head_items)]
    due += [((n + 0.5) / num_packets, DATA, 0, n) for n in range(num_packets)]
    due += [(0.5 + (n + 0.5) / len(parity_items) / 2, PARITY, k, i) for n, (_, k, i) in enumerate(parity_items)]
    return tuple((kind, group, symbol) for _, kind, group, symbol in sorted(due))
