"""What a receiver keeps: the head object's symbols, packets, and parity. Bounded by what was declared and checked."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.errors import BitstreamError
from splatwire.packets import Manifest, Packet, PacketIntake, packet_from_bytes
from splatwire.packets.container import check_side_info
from splatwire.transport import fec
from splatwire.transport.frames import MAX_HELD_BYTES, Data, Parity, Side, Welcome
from splatwire.transport.layout import GroupFinder, Segments, split_head_object
from splatwire.transport.program import MAX_PACKET_BYTES
from splatwire.transport.protection import MIN_SYMBOL_BYTES
from splatwire.transport.wire import MAX_DATAGRAM

SPARE_SYMBOLS = 24
"""Symbols beyond K that are kept when K of them were not enough."""


@dataclass(frozen=True)
class ReceiverLimits:
    """What a receiver is willing to hold.

    Attributes:
        head_bytes: Largest manifest and side information.
        stream_bytes: Largest stream, everything counted.
        packets: Most packets.
    """

    head_bytes: int = 1 << 28
    stream_bytes: int = 1 << 30
    packets: int = 1 << 21


def check_welcome(welcome: Welcome, limits: ReceiverLimits) -> str | None:
    """Says what is wrong with a declaration; nothing is allocated on its word before this."""
    w = welcome
    total = w.object_bytes + w.num_packets * w.packet_bytes
    tiers = sum(tier.num_packets for tier in w.tiers)
    groups_fit = all(
        tier.groups <= tier.num_packets
        and -(-tier.num_packets // max(tier.groups, 1)) <= (fec.MAX_SYMBOLS if tier.groups else tier.num_packets + 1)
        and tier.repair <= fec.MAX_REPAIR
        for tier in w.tiers
    )
    checks = (
        (0 < w.object_bytes <= limits.head_bytes, f"side information of {w.object_bytes} bytes"),
        (w.num_packets <= limits.packets, f"{w.num_packets} packets"),
        (total <= limits.stream_bytes, f"a stream of {total} bytes"),
        (w.packet_bytes <= MAX_PACKET_BYTES, f"packets of {w.packet_bytes} bytes"),
        (w.carried <= w.num_packets, f"{w.carried} of {w.num_packets} packets within the side information"),
        (
            MIN_SYMBOL_BYTES <= w.symbol_bytes <= MAX_DATAGRAM and w.symbol_bytes % fec.ALIGNMENT == 0,
            f"symbols of {w.symbol_bytes} bytes",
        ),
        (tiers == w.num_packets and groups_fit, "a protection that contradicts itself"),
    )
    return next((f"the server announces {what}" for fine, what in checks if not fine), None)


class HeadCollector:
    """Collects the head object.

    Args:
        welcome: Its checked declaration.
    """

    def __init__(self, welcome: Welcome) -> None:
        self._segments = Segments(welcome.object_bytes, welcome.symbol_bytes)
        self._digest = welcome.digest
        self._symbols: list[dict[int, bytes]] = [{} for _ in range(self._segments.num_segments)]
        self._pieces: list[bytes | None] = [None] * self._segments.num_segments
        self.num_poisoned = 0

    @property
    def num_symbols(self) -> int:
        """Symbols that the object is cut into."""
        return self._segments.num_symbols

    @property
    def num_missing(self) -> int:
        """Symbols that are needed at least."""
        missing = 0
        for segment, piece in enumerate(self._pieces):
            if piece is None:
                missing += max(1, self._segments.size(segment) - len(self._symbols[segment]))
        return missing

    def add(self, frame: Side) -> bytes | None:
        """Takes a symbol; gives the whole object when this completes it."""
        if frame.segment >= len(self._pieces) or self._pieces[frame.segment] is not None:
            return None
        size, symbols = self._segments.size(frame.segment), self._symbols[frame.segment]
        useless = frame.symbol in symbols or frame.symbol >= size + fec.MAX_REPAIR
        if useless or len(frame.payload) != self._segments.symbol_bytes:
            return None
        symbols[frame.symbol] = frame.payload
        found = fec.recover(symbols, size, self._segments.symbol_bytes) if len(symbols) >= size else None
        if found is None:
            if len(symbols) > size + SPARE_SYMBOLS:  # bad luck cannot last that long: something is wrong with them
                self._restart(frame.segment)
            return None
        span = self._segments.span(frame.segment)
        self._pieces[frame.segment] = b"".join(found)[: span.stop - span.start]
        symbols.clear()
        return self._whole()

    def _whole(self) -> bytes | None:
        pieces = [piece for piece in self._pieces if piece is not None]
        if len(pieces) < len(self._pieces):
            return None
        data = b"".join(pieces)
        if hashlib.sha256(data).digest() == self._digest:
            return data
        for segment in range(len(self._pieces)):
            self._restart(segment)
        return None

    def _restart(self, segment: int) -> None:
        """Forgets a segment that was built of at least one wrong symbol."""
        self.num_poisoned += 1
        self._symbols[segment].clear()
        self._pieces[segment] = None


def read_head(data: bytes, welcome: Welcome) -> tuple[Manifest, bytes, tuple[bytes, ...]]:
    """Reads the head object and compares it with what was declared.

    Returns:
        The manifest, the side information, and the first packets in sending order.

    Raises:
        BitstreamError: If they contradict each other, or the manifest is not one.
    """
    manifest, side_info, carried = split_head_object(data)
    check_side_info(manifest, side_info, "the side information that was sent")
    if (manifest.stream_id, manifest.num_packets) != (welcome.stream_id, welcome.num_packets):
        raise BitstreamError("the manifest that was sent is that of another stream")
    if len(carried) != welcome.carried:
        raise BitstreamError(f"{len(carried)} packets came with the side information, {welcome.carried} were announced")
    return manifest, side_info, carried


class PacketCollector:
    """Collects packets, and brings lost ones back from parity.

    Args:
        welcome: Their checked declaration.
    """

    def __init__(self, welcome: Welcome) -> None:
        self._welcome = welcome
        self._finder = GroupFinder(welcome.tiers)
        self._symbol_bytes = fec.framed_bytes(welcome.packet_bytes)
        self._have = bytearray(welcome.num_packets)
        self._early: dict[int, Packet] = {}
        self._intake: PacketIntake | None = None
        self._known = 0
        self._members: dict[int, dict[int, Packet]] = {}
        self._repair: dict[int, dict[int, bytes]] = {}
        self.num_packets = 0
        self.num_bad = 0
        self.num_duplicate = 0
        self.num_repaired = 0
        self.highest = -1

    def renew(self, welcome: Welcome) -> None:
        """Goes on with a stream that has grown: packets that are new wait until its manifest is there.

        Codes whose time has passed are forgotten: the sender says of them that they have no repair symbols any more.
        """
        old, self._welcome, self._finder = self._finder, welcome, GroupFinder(welcome.tiers)
        for number in {*self._members, *self._repair}:
            if number >= self._finder.num_groups or self._finder.group(number) != old.group(number):
                self._members.pop(number, None)
                self._repair.pop(number, None)
        self._have.extend(bytes(welcome.num_packets - len(self._have)))

    @property
    def packets(self) -> tuple[Packet, ...]:
        """Good packets, ascending by id; none before the manifest is there."""
        return self._intake.packets if self._intake else ()

    @property
    def intake(self) -> PacketIntake | None:
        """The intake that every packet passed; None before the manifest is there."""
        return self._intake

    def open(self, manifest: Manifest, carried: Sequence[bytes] = ()) -> tuple[PacketIntake, list[Packet]]:
        """Gives what packets pass now, those that came with the manifest, and earlier ones that belong to it."""
        if self._intake is None:
            self._intake = PacketIntake(manifest)
        self._intake.extend(manifest)
        self._known = manifest.num_packets
        early, self._early = self._early, {}
        taken = []
        for index, packet in early.items():
            if self._offer(packet):
                taken.append(packet)
            else:  # it was never one of this stream: its place is free again
                self._release(index)
        for index, data in enumerate(carried):
            new = None if self._have[index] else self._take(index, data)
            if new is not None:
                taken.append(new)
        return self._intake, taken

    def add(self, frame: Data) -> list[Packet]:
        """Takes a packet; gives those that are new because of it, the repaired ones after it."""
        if frame.place >= self._welcome.num_packets or len(frame.packet) > self._welcome.packet_bytes:
            self.num_bad += 1
            return []
        if self._have[frame.place]:
            self.num_duplicate += 1
            return []
        new = self._take(frame.place, frame.packet)
        if new is None:
            return []
        self.highest = max(self.highest, frame.place)
        place = self._finder.find(frame.place)
        out = [new] if self._intake and frame.place < self._known else []
        return out + self._solve(place[0]) if place else out

    def add_parity(self, frame: Parity) -> list[Packet]:
        """Takes a repair symbol; gives the packets that it brings back."""
        if frame.group >= self._finder.num_groups or len(frame.payload) != self._symbol_bytes:
            self.num_bad += 1
            return []
        group = self._finder.group(frame.group)
        if frame.symbol >= group.repair:
            self.num_bad += group.repair > 0  # else it is late: its code is one that has passed
            return []
        if len(self._members.get(frame.group, ())) == group.size:
            return []
        repair = self._repair.setdefault(frame.group, {})
        if len(repair) < group.size + SPARE_SYMBOLS:
            repair[group.size + frame.symbol] = frame.payload
        return self._solve(frame.group)

    def missing(self, start: int, stop: int) -> Iterator[int]:
        """Indices of the packets from `start` to `stop` that are not there, ascending."""
        at = self._have.find(0, start, stop)
        while at >= 0:
            yield at
            at = self._have.find(0, at + 1, stop)

    def held(self) -> Iterator[tuple[int, bytes]]:
        """Packets that are there, as runs of a datagram each: index of the first one, and a bit for each.

        Runs in which nothing is there are left out.
        """
        for first in range(0, len(self._have), 8 * MAX_HELD_BYTES):
            some = np.frombuffer(self._have[first : first + 8 * MAX_HELD_BYTES], np.uint8)
            if some.any():
                yield first, np.packbits(some, bitorder="little").tobytes()

    def _take(self, index: int, data: bytes) -> Packet | None:
        """Believes a packet if its checksum and stream hold, and the manifest's plan has it."""
        try:
            packet = packet_from_bytes(data, self._welcome.stream_id)
        except BitstreamError:
            self.num_bad += 1
            return None
        if self._intake is None or index >= self._known:
            self._early[index] = packet
        elif not self._offer(packet):
            return None
        self._have[index] = 1
        self.num_packets += 1
        place = self._finder.find(index)
        if place:
            self._members.setdefault(place[0], {})[place[1]] = packet
        return packet

    def _offer(self, packet: Packet) -> bool:
        assert self._intake is not None
        if self._intake.take(packet, "datagram"):
            return True
        self.num_bad += 1
        return False

    def _release(self, index: int) -> None:
        self._have[index] = 0
        self.num_packets -= 1
        place = self._finder.find(index)
        if place:
            self._members.get(place[0], {}).pop(place[1], None)

    def _solve(self, number: int) -> list[Packet]:
        """Rebuilds a group's lost packets as soon as enough of it is there."""
        group, repair = self._finder.group(number), self._repair.get(number, {})
        members = self._members.setdefault(number, {})
        if not repair or len(members) == group.size or len(members) + len(repair) < group.size:
            return []
        symbols = {n: fec.framed([packet.data], self._symbol_bytes) for n, packet in members.items()}
        found = fec.recover({**symbols, **repair}, group.size, self._symbol_bytes)
        if found is None:
            return []
        out = []
        for n, symbol in enumerate(found):
            if n not in members:
                place = group.packet_of(n)
                packet = self._take(place, fec.unframed(symbol))
                self.num_repaired += packet is not None
                if packet is not None and self._intake and place < self._known:
                    out.append(packet)
        del self._repair[number]
        return out
