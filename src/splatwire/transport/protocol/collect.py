"""Collects the symbols and packets that a receiver gets, and recovers lost ones."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.bitstream import Manifest, Packet, PacketIntake, packet_from_bytes
from splatwire.bitstream.container import check_side_info
from splatwire.errors import BitstreamError
from splatwire.transport import fec
from splatwire.transport.protocol.layout import ParityGroupFinder, SourceBlocks, split_init_segment
from splatwire.transport.protocol.messages import MAX_HELD_BYTES, Data, InitSymbol, Parity, Welcome
from splatwire.transport.protocol.protection import MIN_SYMBOL_BYTES
from splatwire.transport.protocol.served_stream import MAX_PACKET_BYTES
from splatwire.transport.protocol.wire import MAX_DATAGRAM

SPARE_SYMBOLS = 24
"""Number of symbols beyond the K source symbols that are stored if K received symbols were not enough to decode."""


@dataclass(frozen=True)
class ReceiverLimits(CheckedFields):
    """Maximum sizes of a stream that a receiver accepts.

    Attributes:
        init_segment_bytes: Maximum size of the init segment (manifest, side information, bundled packets) in bytes.
        stream_bytes: Maximum size of the whole stream, bytes.
        packets: Maximum number of packets of the stream.
    """

    init_segment_bytes: int = 1 << 28
    stream_bytes: int = 1 << 30
    packets: int = 1 << 21


def check_welcome(welcome: Welcome, limits: ReceiverLimits) -> str | None:
    """Checks the sizes of a stream in the server's response (welcome) before any memory is allocated for the stream.

    Args:
        welcome: Response of the server.
        limits: Maximum accepted sizes.

    Returns:
        Message about what is invalid or too large, or None if the sizes are accepted.
    """
    w = welcome
    total = w.init_segment_bytes + w.num_packets * w.max_packet_bytes
    covered = sum(parity_range.num_packets for parity_range in w.parity_ranges)
    groups_fit = all(
        parity_range.groups <= parity_range.num_packets
        and -(-parity_range.num_packets // max(parity_range.groups, 1))
        <= (fec.MAX_SYMBOLS if parity_range.groups else parity_range.num_packets + 1)
        and parity_range.repair <= fec.MAX_REPAIR
        for parity_range in w.parity_ranges
    )
    checks = (
        (0 < w.init_segment_bytes <= limits.init_segment_bytes, f"an init segment of {w.init_segment_bytes} bytes"),
        (w.num_packets <= limits.packets, f"{w.num_packets} packets"),
        (total <= limits.stream_bytes, f"a stream of {total} bytes"),
        (w.max_packet_bytes <= MAX_PACKET_BYTES, f"packets of {w.max_packet_bytes} bytes"),
        (w.num_bundled <= w.num_packets, f"{w.num_bundled} of {w.num_packets} packets within the init segment"),
        (
            MIN_SYMBOL_BYTES <= w.symbol_bytes <= MAX_DATAGRAM and w.symbol_bytes % fec.ALIGNMENT == 0,
            f"symbols of {w.symbol_bytes} bytes",
        ),
        (covered == w.num_packets and groups_fit, "a protection that contradicts itself"),
    )
    return next((f"the server announces {problem}" for is_valid, problem in checks if not is_valid), None)


class InitSegmentCollector:
    """Decodes the init segment (manifest, side information, bundled packets) from its symbols.

    Args:
        welcome: Server's response with the sizes of the stream, already checked.
    """

    def __init__(self, welcome: Welcome) -> None:
        self._source_blocks = SourceBlocks(welcome.init_segment_bytes, welcome.symbol_bytes)
        self._digest = welcome.digest
        self._symbols: list[dict[int, bytes]] = [{} for _ in range(self._source_blocks.num_blocks)]
        self._pieces: list[bytes | None] = [None] * self._source_blocks.num_blocks
        self.num_poisoned = 0

    @property
    def num_symbols(self) -> int:
        """Total number of source symbols of the init segment."""
        return self._source_blocks.num_symbols

    @property
    def num_missing(self) -> int:
        """Minimum number of symbols that are still needed to decode the init segment."""
        missing = 0
        for source_block, piece in enumerate(self._pieces):
            if piece is None:
                missing += max(1, self._source_blocks.size(source_block) - len(self._symbols[source_block]))
        return missing

    def add(self, message: InitSymbol) -> bytes | None:
        """Adds a received symbol of the init segment.

        Args:
            message: The datagram with the symbol; invalid and repeated symbols are ignored.

        Returns:
            Bytes of the init segment if it is complete now, else None.
        """
        if message.source_block >= len(self._pieces) or self._pieces[message.source_block] is not None:
            return None
        size, symbols = self._source_blocks.size(message.source_block), self._symbols[message.source_block]
        is_useless = message.symbol in symbols or message.symbol >= size + fec.MAX_REPAIR
        if is_useless or len(message.payload) != self._source_blocks.symbol_bytes:
            return None
        symbols[message.symbol] = message.payload
        block_data = fec.recover(symbols, size, self._source_blocks.symbol_bytes) if len(symbols) >= size else None
        if block_data is None:
            if len(symbols) > size + SPARE_SYMBOLS:  # improbable for valid symbols: at least one is corrupt
                self._discard_block(message.source_block)
            return None
        span = self._source_blocks.span(message.source_block)
        self._pieces[message.source_block] = b"".join(block_data)[: span.stop - span.start]
        symbols.clear()
        return self._joined()

    def _joined(self) -> bytes | None:
        """Returns the init segment if all source blocks are decoded. Discards all blocks if the digest is wrong."""
        pieces = [piece for piece in self._pieces if piece is not None]
        if len(pieces) < len(self._pieces):
            return None
        data = b"".join(pieces)
        if hashlib.sha256(data).digest() == self._digest:
            return data
        for source_block in range(len(self._pieces)):
            self._discard_block(source_block)
        return None

    def _discard_block(self, source_block: int) -> None:
        """Discards all received symbols of a source block of the init segment, because one of them is corrupt.

        Args:
            source_block: Index of the source block (part of the init segment that is coded separately).
        """
        self.num_poisoned += 1
        self._symbols[source_block].clear()
        self._pieces[source_block] = None


def read_init_segment(data: bytes, welcome: Welcome) -> tuple[Manifest, bytes, tuple[bytes, ...]]:
    """Parses the init segment and checks it against the server's response (welcome).

    Args:
        data: Bytes of the init segment.
        welcome: Server's response with the sizes of the stream.

    Returns:
        Manifest, side information, and the packets bundled in the init segment.

    Raises:
        BitstreamError: If the init segment contradicts the server's response, or the manifest is invalid.
    """
    manifest, side_info, bundled = split_init_segment(data)
    check_side_info(manifest, side_info, "the side information that was sent")
    if (manifest.stream_id, manifest.num_packets) != (welcome.stream_id, welcome.num_packets):
        raise BitstreamError("the manifest that was sent is that of another stream")
    if len(bundled) != welcome.num_bundled:
        raise BitstreamError(f"{len(bundled)} packets are bundled with the side information, not {welcome.num_bundled}")
    return manifest, side_info, bundled


class PacketCollector:
    """Collects received packets and recovers lost packets from repair symbols.

    Args:
        welcome: Server's response with the sizes of the stream, already checked.
    """

    def __init__(self, welcome: Welcome) -> None:
        self._welcome = welcome
        self._finder = ParityGroupFinder(welcome.parity_ranges)
        self._symbol_bytes = fec.symbol_bytes_for(welcome.max_packet_bytes)
        self._is_received = bytearray(welcome.num_packets)
        self._early: dict[int, Packet] = {}
        self._intake: PacketIntake | None = None
        self._num_listed = 0
        self._members: dict[int, dict[int, Packet]] = {}
        self._repair: dict[int, dict[int, bytes]] = {}
        self.num_packets = 0
        self.num_bad = 0
        self.num_duplicate = 0
        self.num_repaired = 0
        self.highest_index = -1

    def extend(self, welcome: Welcome) -> None:
        """Prepares for more packets after a live stream has grown; received packets are kept.

        Args:
            welcome: Server's response with the new sizes of the stream, already checked.
        """
        old, self._welcome, self._finder = self._finder, welcome, ParityGroupFinder(welcome.parity_ranges)
        for number in {*self._members, *self._repair}:
            if number >= self._finder.num_groups or self._finder.group(number) != old.group(number):
                self._members.pop(number, None)
                self._repair.pop(number, None)
        self._is_received.extend(bytes(welcome.num_packets - len(self._is_received)))

    @property
    def packets(self) -> tuple[Packet, ...]:
        """Valid packets received so far, ascending by id, or no packets before the manifest is known."""
        return self._intake.packets if self._intake else ()

    @property
    def intake(self) -> PacketIntake | None:
        """Filter that checks every packet against the manifest; None before the manifest is known."""
        return self._intake

    def open(self, manifest: Manifest, bundled: Sequence[bytes] = ()) -> tuple[PacketIntake, list[Packet]]:
        """Processes a new manifest: checks and stores the packets that arrived before the manifest.

        Args:
            manifest: Manifest of the stream.
            bundled: Packets bundled in the init segment.

        Returns:
            Filter that checks packets against the manifest; and the packets that were accepted now.
        """
        if self._intake is None:
            self._intake = PacketIntake(manifest)
        self._intake.extend(manifest)
        self._num_listed = manifest.num_packets
        early, self._early = self._early, {}
        taken = []
        for index, packet in early.items():
            if self._offer(packet):
                taken.append(packet)
            else:  # not a packet of this stream: its index is free again
                self._forget(index)
        for index, data in enumerate(bundled):
            new = None if self._is_received[index] else self._take(index, data)
            if new is not None:
                taken.append(new)
        return self._intake, taken

    def add(self, message: Data) -> list[Packet]:
        """Adds a received packet.

        Args:
            message: Datagram with the packet. An invalid or repeated packet is counted and ignored.

        Returns:
            The packets that can be decoded now: the new packet, and all lost packets that can be recovered with it. A
            packet that the current manifest does not list yet is only stored, and is returned by `open` later.
        """
        if message.packet_index >= self._welcome.num_packets or len(message.packet) > self._welcome.max_packet_bytes:
            self.num_bad += 1
            return []
        if self._is_received[message.packet_index]:
            self.num_duplicate += 1
            return []
        new = self._take(message.packet_index, message.packet)
        if new is None:
            return []
        self.highest_index = max(self.highest_index, message.packet_index)
        found = self._finder.find(message.packet_index)
        out = [new] if self._intake and message.packet_index < self._num_listed else []
        return out + self._recover_group(found[0]) if found else out

    def add_parity(self, message: Parity) -> list[Packet]:
        """Adds a received repair symbol, and returns the lost packets that can now be recovered."""
        if message.group >= self._finder.num_groups or len(message.payload) != self._symbol_bytes:
            self.num_bad += 1
            return []
        group = self._finder.group(message.group)
        if message.symbol >= group.repair:
            self.num_bad += group.repair > 0  # else it is late, for an expired parity group
            return []
        if len(self._members.get(message.group, ())) == group.size:
            return []
        repair = self._repair.setdefault(message.group, {})
        if len(repair) < group.size + SPARE_SYMBOLS:
            repair[group.size + message.symbol] = message.payload
        return self._recover_group(message.group)

    def missing(self, start: int, stop: int) -> Iterator[int]:
        """Yields the indices of missing packets from `start` to `stop` (exclusive), ascending."""
        index = self._is_received.find(0, start, stop)
        while index >= 0:
            yield index
            index = self._is_received.find(0, index + 1, stop)

    def received_masks(self) -> Iterator[tuple[int, bytes]]:
        """Yields bit masks of the received packets, divided so that each mask fits into one datagram.

        Yields:
            Index of the first packet in the mask, and the mask, least significant bit first.
        """
        for first in range(0, len(self._is_received), 8 * MAX_HELD_BYTES):
            bits = np.frombuffer(self._is_received[first : first + 8 * MAX_HELD_BYTES], np.uint8)
            if bits.any():
                yield first, np.packbits(bits, bitorder="little").tobytes()

    def _take(self, index: int, data: bytes) -> Packet | None:
        """Validates and stores a received packet.

        Returns None for an invalid packet.
        """
        try:
            packet = packet_from_bytes(data, self._welcome.stream_id)
        except BitstreamError:
            self.num_bad += 1
            return None
        if self._intake is None or index >= self._num_listed:
            self._early[index] = packet
        elif not self._offer(packet):
            return None
        self._is_received[index] = 1
        self.num_packets += 1
        if found := self._finder.find(index):
            group, symbol = found
            self._members.setdefault(group, {})[symbol] = packet
        return packet

    def _offer(self, packet: Packet) -> bool:
        """Passes a packet to the intake, and returns True if it belongs to the stream."""
        assert self._intake is not None
        if self._intake.add(packet, "datagram"):
            return True
        self.num_bad += 1
        return False

    def _forget(self, index: int) -> None:
        """Removes a packet, so that another packet can take its index."""
        self._is_received[index] = 0
        self.num_packets -= 1
        if found := self._finder.find(index):
            group, symbol = found
            self._members.get(group, {}).pop(symbol, None)

    def _recover_group(self, number: int) -> list[Packet]:
        """Recovers the lost packets of a parity group if enough repair symbols have been received.

        Args:
            number: Index of the parity group.

        Returns:
            The recovered packets that the current manifest lists; empty if too few symbols have been received.
        """
        group, repair = self._finder.group(number), self._repair.get(number, {})
        members = self._members.setdefault(number, {})
        if not repair or len(members) == group.size or len(members) + len(repair) < group.size:
            return []
        symbols = {n: fec.framed([packet.data], self._symbol_bytes) for n, packet in members.items()}
        source_symbols = fec.recover({**symbols, **repair}, group.size, self._symbol_bytes)
        if source_symbols is None:
            return []
        out = []
        for n, symbol in enumerate(source_symbols):
            if n not in members:
                index = group.packet_of(n)
                packet = self._take(index, fec.unframed(symbol))
                self.num_repaired += packet is not None
                if packet is not None and self._intake and index < self._num_listed:
                    out.append(packet)
        del self._repair[number]
        return out
