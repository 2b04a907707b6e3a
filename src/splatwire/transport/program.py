"""What a server sends of a stream, in which order: computed once, shared by all clients, never changed."""

import functools
import hashlib
import itertools
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
MIN_SYMBOL_BYTES = 64
FINEST_BY_ITSELF = 256
"""Size below which symbols are only cut when asked for: their headers cost more than they save in repair."""
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
        side_symbol_bytes: Size of the symbols of the head object, a multiple of 8; None chooses. Many small ones need
            fewer repair bytes (the share of many that is lost varies less), yet each has its own headers.
        tiers: Protection of the packets by their place in the sending order; what the shares leave over has no parity.
        tier_repair: Instead of `tiers`, repair symbols for each packet of the stream's own tiers of importance, tier 0
            (which travels first) first; tiers beyond have no parity.
        parity_until: Parity of a tier leaves between its middle and this share of all packets (or its own end, if that
            is later), 0 to 1: small brings lost packets back soon, large survives longer bursts.

    Raises:
        InvalidValueError: If a number is out of range, or tiers are given in both ways.
    """

    side_repair: float = 0.35
    side_lead: float = 0.4
    side_symbol_bytes: int | None = None
    tiers: tuple[Tier, ...] = ()
    tier_repair: tuple[float, ...] = ()
    parity_until: float = 1.0

    def __post_init__(self) -> None:
        checks = [("side_repair", self.side_repair, 2.0), ("side_lead", self.side_lead, 1.0)]
        checks += [("parity_until", self.parity_until, 1.0)]
        checks += [("repair of a tier", repair, 2.0) for repair in self.tier_repair]
        for tier in self.tiers:
            checks += [("share of a tier", tier.share, 1.0), ("repair of a tier", tier.repair, 2.0)]
        for name, value, high in checks:
            if not 0.0 <= value <= high:
                raise InvalidValueError(f"{name} must be from 0 to {high}, not {value}")
        size = self.side_symbol_bytes
        if size is not None and not (MIN_SYMBOL_BYTES <= size <= SIDE_SYMBOL_BYTES and size % ALIGNMENT == 0):
            raise InvalidValueError(
                f"symbols of side information have a multiple of {ALIGNMENT} bytes from {MIN_SYMBOL_BYTES} to "
                f"{SIDE_SYMBOL_BYTES}, not {size}"
            )
        if self.tiers and self.tier_repair:
            raise InvalidValueError("parity goes by place in the sending order or by the stream's tiers, not by both")
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

    @functools.cached_property
    def reliable_schedule(self) -> tuple[tuple[int, int, int], ...]:
        """The same order where the head object travels on a reliable stream: without its repair symbols."""
        segments = Segments(self.head_bytes, self.symbol_bytes)
        return tuple(item for item in self.schedule if item[0] != SIDE or item[2] < segments.size(item[1]))

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
    plan = manifest.plan
    tier_of = [plan.tier_of(block) for block in range(plan.num_blocks)]
    ordered = list(order) if order is not None else interleaved(stream.packets, tier_of)
    packets = tuple(packet_to_bytes(packet, manifest.stream_id) for packet in ordered)
    largest = max(map(len, packets), default=0)
    if largest > MAX_PACKET_BYTES:
        raise InvalidValueError(
            f"a packet of {largest} bytes fits no datagram (at most {MAX_PACKET_BYTES}): encode with --preset datagram"
        )
    data = head_object(manifest, stream.side_info)
    symbol_bytes = protection.side_symbol_bytes or side_symbol_bytes(len(data))
    head = _head_symbols(data, symbol_bytes, protection.side_repair)
    tiers = protected_tiers([tier_of[packet.id.block] for packet in ordered], protection)
    parity = _parity(packets, tiers, framed_bytes(largest))
    return Program(
        manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, head, packets, largest, tiers,
        parity, timetable([*map(len, head)], tiers, [*map(len, parity)], protection),
    )  # fmt: skip


def interleaved(packets: Sequence[Packet], tier_of: Sequence[int] = ()) -> list[Packet]:
    """Sending order: tier by tier, in each lane by lane (or hash position) over all blocks, which spreads bursts.

    Args:
        packets: All packets.
        tier_of: Tier of each block; empty if there is one.
    """
    return sorted(packets, key=lambda p: (tier_of[p.id.block] if tier_of else 0, p.id.lane, p.id.part, p.id.block))


def side_symbol_bytes(num_bytes: int) -> int:
    """Size of the symbols of a head object."""
    finer = num_bytes // SMALL_OBJECT_SYMBOLS // ALIGNMENT * ALIGNMENT
    return min(max(finer, FINEST_BY_ITSELF), SIDE_SYMBOL_BYTES)


def _head_symbols(data: bytes, symbol_bytes: int, share: float) -> tuple[tuple[bytes, ...], ...]:
    segments = Segments(len(data), symbol_bytes)
    out = []
    for segment in range(segments.num_segments):
        piece = data[segments.span(segment)]
        repair = min(round(share * segments.size(segment)), MAX_REPAIR)
        out.append((*source_symbols(piece, symbol_bytes), *repair_symbols(piece, symbol_bytes, repair)))
    return tuple(out)


def protected_tiers(tiers: Sequence[int], protection: Protection) -> tuple[TierHead, ...]:
    """Protection of runs of packets.

    Args:
        tiers: Tier of importance of each packet, in sending order.
        protection: Where redundancy goes.

    Raises:
        InvalidValueError: If there is parity for tiers that the stream does not have, or an order that mixes them.
    """
    return _tier_heads(_runs(tiers, protection), len(tiers))


def _runs(tiers: Sequence[int], protection: Protection) -> list[tuple[int, float]]:
    """Runs of packets in sending order: how many, and repair symbols for each of them.

    Raises:
        InvalidValueError: If there is parity for tiers that the stream does not have, or an order that mixes them.
    """
    if not protection.tier_repair:
        edges, share = [0], 0.0
        for tier in protection.tiers:
            share += tier.share
            edges.append(round(share * len(tiers)))
        return [(stop - start, t.repair) for start, stop, t in zip(edges, edges[1:], protection.tiers, strict=False)]
    present = max(tiers, default=0) + 1
    if len(protection.tier_repair) > present:
        raise InvalidValueError(
            f"parity for {len(protection.tier_repair)} tiers, and the stream has {present}: encode with --tiers"
        )
    if any(after < before for before, after in itertools.pairwise(tiers)):
        raise InvalidValueError("the sending order mixes tiers, so that they cannot be protected apart")
    return [(tiers.count(tier), repair) for tier, repair in enumerate(protection.tier_repair)]


def _tier_heads(runs: Sequence[tuple[int, float]], num_packets: int) -> tuple[TierHead, ...]:
    heads, first = [], 0
    for size, share in runs:
        groups = -(-size // MAX_SYMBOLS) if share else 0
        repair = min(round(share * num_symbols(size, groups)), MAX_REPAIR) if groups else 0
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


def timetable(
    head: Sequence[int], tiers: Sequence[TierHead], parity: Sequence[int], protection: Protection
) -> tuple[tuple[int, int, int], ...]:
    """Spreads the head object over the first share of the packets, and each tier's parity from its middle on.

    Each datagram has a due time from 0 to 1; symbols of different segments and groups take turns.

    Args:
        head: Symbols of each segment of the head object, source and repair.
        tiers: Protection of the packets.
        parity: Repair symbols of each group.
        protection: When parity and head object are sent.

    Returns:
        What is sent, in order, as `Program.schedule`.
    """
    num_packets = sum(tier.num_packets for tier in tiers)
    head_items = sorted(((n / size, k, n) for k, size in enumerate(head) for n in range(size)))
    due = [((n + 0.5) / len(head_items) * protection.side_lead, SIDE, k, i) for n, (_, k, i) in enumerate(head_items)]
    due += [((n + 0.5) / num_packets, DATA, 0, n) for n in range(num_packets)]
    first = group = 0
    for tier in tiers:
        groups = range(group, group + tier.groups)
        items = sorted((n / parity[k], k, n) for k in groups for n in range(parity[k]))
        start, end = (first + tier.num_packets / 2) / num_packets, (first + tier.num_packets) / num_packets
        long = max(end, protection.parity_until) - start
        due += [(start + (n + 0.5) / len(items) * long, PARITY, k, i) for n, (_, k, i) in enumerate(items)]
        first, group = first + tier.num_packets, group + tier.groups
    return tuple((kind, group, symbol) for _, kind, group, symbol in sorted(due))
