"""What a server sends of a stream, in which order: computed once, shared by all clients, never changed."""

import functools
import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.packets import Packet, PacketId, SceneStream, send_sequence
from splatwire.packets.tiles import Tiles, read_tiles
from splatwire.transport.fec import ALIGNMENT, MAX_REPAIR, framed, framed_bytes, repair_symbols, source_symbols
from splatwire.transport.frames import MAX_PREVIEW, MAX_TIERS, MORE, VIEWS, TierHead
from splatwire.transport.layout import Group, Segments, head_object, parity_groups
from splatwire.transport.motion import arrange, group_packets
from splatwire.transport.protection import (
    SIDE_SYMBOL_BYTES,
    Protection,
    carried_packets,
    packets_in_tiers,
    protected_tiers,
)
from splatwire.transport.timetable import timetable
from splatwire.transport.wire import DATA, DATA_OVERHEAD, PARITY, PARITY_OVERHEAD, SIDE, SIDE_OVERHEAD

MAX_PACKET_BYTES = 1150
FINEST_BY_ITSELF = 256
"""Size below which symbols are only cut when asked for: their headers cost more than they save in repair."""
RESERVE = 0.5
"""Repair symbols of the head object beyond those of the schedule, as a share of its source symbols."""
OPENING_BYTES = 1 << 18
"""Of the coarsest tiles, sent before what is looked at: something of everything, and what hides what is lost."""
SMALL_OBJECT_SYMBOLS = 600
"""A small head object is cut finer: the share of many symbols that is lost varies less than that of few."""


class SendSchedule(NamedTuple):
    """Items in sending order, and the places in this same order at which something ends.

    Attributes:
        items: Kind, segment or group (0 for a packet), symbol or index of each.
        head_end: Number of items after which every symbol of the head object has been sent once.
        opening_end: Number of items that are sent before any view counts; of a program with tiles only.
    """

    items: Sequence[tuple[int, int, int]]
    head_end: int
    opening_end: int


@dataclass(frozen=True, eq=False)
class Program:
    """All that may be sent of a stream.

    Attributes:
        stream_id: Id that every packet carries.
        head_bytes: Size of the head object.
        head_digest: SHA-256 of the head object.
        symbol_bytes: Size of its symbols.
        head: Symbols of each segment: source, repair, and a reserve of repair that leaves when more is asked for.
        packets: Packets in sending order, as bytes.
        packet_bytes: Most bytes of one.
        carried: Packets that are in the head object, the first ones; they leave by themselves only when asked for.
        tiers: Protection of the packets.
        parity: Repair symbols of each group.
        schedule: What is sent once, in order: kind, segment or group (0 for a packet), symbol or index.
        preview: What the welcome shows of the scene.
        resend: Most bytes that are sent again on request, as a share of one pass; None for no such limit.
        resendable: Packets that are sent again at all, the first ones; None for all.
        tiles: What views are of; None of a stream without levels.
        opening_packets: Number of packets, the first ones, that are sent before any view counts: those of the coarsest
            tiles. The head object and the parity of these packets belong to them.
    """

    stream_id: int
    head_bytes: int
    head_digest: bytes
    symbol_bytes: int
    head: tuple[tuple[bytes, ...], ...]
    packets: tuple[bytes, ...]
    packet_bytes: int
    carried: int
    tiers: tuple[TierHead, ...]
    parity: tuple[tuple[bytes, ...], ...]
    schedule: tuple[tuple[int, int, int], ...]
    preview: bytes = b""
    resend: float | None = None
    resendable: int | None = None
    tiles: Tiles | None = None
    opening_packets: int = 0

    @functools.cached_property
    def send_schedule(self) -> SendSchedule:
        """Schedule where the head object travels in datagrams."""
        return self.schedule_of(self.schedule)

    @functools.cached_property
    def reliable_schedule(self) -> SendSchedule:
        """Schedule where the head object travels on a reliable stream: first and without repair symbols.

        Nothing is decoded without the head object.
        """
        segments = Segments(self.head_bytes, self.symbol_bytes)
        head = (item for item in self.schedule if item[0] == SIDE and item[2] < segments.size(item[1]))
        return self.schedule_of((*head, *(item for item in self.schedule if item[0] != SIDE)))

    def schedule_of(self, items: Sequence[tuple[int, int, int]]) -> SendSchedule:
        """Returns a schedule of some items of this program, with the places that are counted in it."""
        last_of_head = last_of_opening = -1
        for place, item in enumerate(items):
            if item[0] == SIDE:
                last_of_head = place
            if self.tiles is not None and self.in_opening(item):
                last_of_opening = place
        return SendSchedule(items, last_of_head + 1, last_of_opening + 1)

    def in_opening(self, item: tuple[int, int, int]) -> bool:
        """Returns True for an item that is sent before any view counts: see `opening_packets`."""
        kind, group, symbol = item
        if kind == PARITY:
            members = self._groups[group]
            return members.packet_of(members.size - 1) < self.opening_packets
        return kind == SIDE or (kind == DATA and symbol < self.opening_packets)

    @functools.cached_property
    def _groups(self) -> list[Group]:
        return parity_groups(self.tiers)

    @functools.cached_property
    def head_reserve(self) -> int:
        """The first symbol of each segment that no schedule has."""
        counts = Counter(segment for kind, segment, _ in self.schedule if kind == SIDE)
        return min(counts.values())

    @functools.cached_property
    def resend_bytes(self) -> float:
        """Most bytes that are sent again on request; infinite without a limit."""
        return math.inf if self.resend is None else self.resend * sum(self.sizes().values())

    @property
    def counts_bytes(self) -> bool:
        """Whether what is sent again is limited; then little is sent beyond what a client lacks."""
        return self.resend is not None or self.num_resendable < len(self.packets)

    @functools.cached_property
    def num_resendable(self) -> int:
        """Packets that are sent again on request, the first ones."""
        return len(self.packets) if self.resendable is None else self.resendable

    def resends(self, index: int) -> bool:
        """Whether a packet is sent again on request."""
        return index < self.num_resendable

    def wants(self, kind: int, group: int, symbol: int) -> bool:
        """Whether a packet or a repair symbol of one that waits to leave is worth it still."""
        if kind == PARITY:
            return group < len(self.parity) and symbol < len(self.parity[group])
        return kind == DATA and self.resends(symbol)

    @property
    def open(self) -> bool:
        """Whether more is to come than is known by now."""
        return bool(self.tiers) and self.tiers[-1] == MORE

    def sizes(self) -> dict[str, int]:
        """Bytes of one complete pass, by what they are for; headers of datagrams (not of UDP and IP) included."""
        segments = Segments(self.head_bytes, self.symbol_bytes)
        per_symbol, source = self.symbol_bytes + SIDE_OVERHEAD, segments.num_symbols
        repair = sum(1 for kind, _, _ in self.schedule if kind == SIDE) - source
        parity = sum(len(symbol) + PARITY_OVERHEAD for group in self.parity for symbol in group)
        return {
            "side": source * per_symbol,
            "side_protection": repair * per_symbol,
            "packets": sum(DATA_OVERHEAD + len(packet) for packet in self.packets[self.carried :]),
            "packet_protection": parity,
        }


def make_program(
    stream: SceneStream, protection: Protection | None = None, *, preview: bytes = b"",
    worth: Mapping[PacketId, float] | None = None,
) -> Program:  # fmt: skip
    """Prepares a stream for sending.

    Args:
        stream: The complete stream; its packets must fit datagrams.
        protection: Where redundancy goes.
        preview: What the welcome shows of the scene (`splatwire.transport.preview.stream_preview`).
        worth: Of a clip: what losing each packet of motion costs; None: all alike.

    Raises:
        InvalidValueError: If packets are missing, or one of them or the preview is too large for a datagram.
        BackendUnavailableError: If parity is asked for and the package `raptorq` is not installed.
    """
    manifest, protection = stream.manifest, protection or Protection()
    tiles = read_tiles(manifest, stream.side_info) if manifest.schema.tiled else None
    if tiles is not None and not protection.tier_repair:  # nothing is drawn where the coarsest tile is missing
        protection = replace(protection, tier_repair=(protection.side_repair,))
    if len(stream.packets) != manifest.num_packets:
        raise InvalidValueError(
            f"{len(stream.packets)} of {manifest.num_packets} packets: only a complete stream is served"
        )
    if len(preview) > MAX_PREVIEW:
        raise InvalidValueError(f"a preview of {len(preview):,} bytes: a welcome carries at most {MAX_PREVIEW}")
    ordered, tiers = _ordered(stream, protection, worth)
    packets = tuple(packet.data for packet in ordered)
    largest = max(map(len, packets), default=0)
    if largest > MAX_PACKET_BYTES:
        raise InvalidValueError(
            f"a packet of {largest} bytes fits no datagram (at most {MAX_PACKET_BYTES}): encode with --preset datagram"
        )
    carried = carried_packets(len(packets), protection)
    data = head_object(manifest, stream.side_info, packets[:carried])
    symbol_bytes = protection.side_symbol_bytes or side_symbol_bytes(len(data))
    head, scheduled = head_symbols(data, symbol_bytes, protection)
    members = [manifest.plan.tier_of(packet.id.block) for packet in ordered]
    timing = replace(protection, parity_until=0.0) if protection.motion else protection
    parity = parity_symbols(packets, tiers, framed_bytes(largest))
    program = Program(
        manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, head, packets, largest, carried,
        tiers, parity, timetable(scheduled, tiers, [*map(len, parity)], timing, packets_in_tiers(members, protection)),
        preview, protection.resend, round(protection.resend_until * len(packets)),
    )  # fmt: skip
    return program if tiles is None else _for_views(program, tiles)


def _for_views(program: Program, tiles: Tiles) -> Program:
    """The same with what is looked at first: the coarsest tiles, the first of which leaves in any case."""
    count = max(1, int(np.searchsorted(np.cumsum(tiles.sizes), OPENING_BYTES, "right")))
    last = max(int(tiles.first_packets[count]), program.carried)
    program = replace(program, opening_packets=last)
    first = tuple(filter(program.in_opening, program.schedule))
    rest = tuple(item for item in program.schedule if not program.in_opening(item))
    told = (VIEWS,) if len(program.tiers) < MAX_TIERS else ()
    return replace(program, tiers=(*program.tiers, *told), schedule=first + rest, tiles=tiles if told else None)


def _ordered(
    stream: SceneStream, protection: Protection, worth: Mapping[PacketId, float] | None
) -> tuple[list[Packet], tuple[TierHead, ...]]:
    """Packets in sending order, and the parity over runs of them."""
    ordered, plan = send_sequence(stream, "tiers"), stream.manifest.plan
    if not protection.motion:
        return ordered, protected_tiers([plan.tier_of(packet.id.block) for packet in ordered], protection)
    if not stream.manifest.schema.timed or protection.tier_repair or protection.tier_spread:
        raise InvalidValueError("parity for the motion of groups of frames is for a clip, and excludes that for tiers")
    costs = None if worth is None else [worth.get(packet.id, 0.0) for packet in ordered]
    found = arrange(group_packets(ordered, plan), costs, protection)
    return [ordered[number] for number in found.order], found.tiers


def side_symbol_bytes(num_bytes: int) -> int:
    """Size of the symbols of a head object."""
    finer = num_bytes // SMALL_OBJECT_SYMBOLS // ALIGNMENT * ALIGNMENT
    return min(max(finer, FINEST_BY_ITSELF), SIDE_SYMBOL_BYTES)


def head_symbols(
    data: bytes, symbol_bytes: int, protection: Protection
) -> tuple[tuple[tuple[bytes, ...], ...], list[int]]:
    """The symbols of each segment, and how many of them the schedule has; no reserve where no repair is wanted."""
    segments = Segments(len(data), symbol_bytes)
    out, scheduled = [], []
    for segment in range(segments.num_segments):
        piece = data[segments.span(segment)]
        size = segments.size(segment)
        repair = min(round(protection.side_repair * size), MAX_REPAIR)
        wanted = repair > 0 or protection.limits_resending
        whole = min(repair + math.ceil(RESERVE * size), MAX_REPAIR) if wanted else 0
        out.append((*source_symbols(piece, symbol_bytes), *repair_symbols(piece, symbol_bytes, whole)))
        scheduled.append(size + repair)
    return tuple(out), scheduled


def parity_symbols(
    packets: Sequence[bytes], tiers: Sequence[TierHead], symbol_bytes: int
) -> tuple[tuple[bytes, ...], ...]:
    """Repair symbols of each parity group of some packets."""
    out = []
    for group in parity_groups(tiers):
        members = [packets[group.packet_of(n)] for n in range(group.size)]
        out.append(tuple(repair_symbols(framed(members, symbol_bytes), symbol_bytes, group.repair)))
    return tuple(out)
