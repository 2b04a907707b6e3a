"""Divides data into source blocks of the erasure code, in the same way on sender and receiver.

The init segment (manifest, side information, first packets) is split into source blocks, and the packets into parity
groups.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from splatwire.bitstream.limits import MAX_MANIFEST_BYTES
from splatwire.bitstream.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.errors import BitstreamError
from splatwire.transport.fec import MAX_SYMBOLS, num_symbols
from splatwire.transport.protocol.messages import ParityRange

_MANIFEST_SIZE = struct.Struct("<I")
_PACKET_SIZE = struct.Struct("<H")


def init_segment(manifest: Manifest, side_info: bytes, packets: Sequence[bytes] = ()) -> bytes:
    """Returns the init segment of a stream: the data that a client needs first.

    It consists of manifest, side information and bundled packets.

    Args:
        manifest: Manifest of the stream.
        side_info: Side information of the stream (data that all packets need).
        packets: Packets to bundle, the first in sending order.
    """
    data = manifest_to_bytes(manifest)
    bundled = b"".join(_PACKET_SIZE.pack(len(packet)) + packet for packet in packets)
    return _MANIFEST_SIZE.pack(len(data)) + data + side_info + bundled


def bundled_bytes(packet_bytes: int, count: int) -> int:
    """Returns the size that bundled packets add to the init segment, in bytes.

    Args:
        packet_bytes: Total size of the bundled packets in bytes.
        count: Number of bundled packets.
    """
    return packet_bytes + count * _PACKET_SIZE.size


def split_init_segment(data: bytes) -> tuple[Manifest, bytes, tuple[bytes, ...]]:
    """Divides an init segment into manifest, side information and bundled packets.

    Raises:
        BitstreamError: If the data are not an init segment.
    """
    if len(data) < _MANIFEST_SIZE.size:
        raise BitstreamError("the init segment is cut")
    (size,) = _MANIFEST_SIZE.unpack_from(data)
    if size > MAX_MANIFEST_BYTES or _MANIFEST_SIZE.size + size > len(data):
        raise BitstreamError(f"the init segment's manifest cannot have {size} bytes")
    manifest = manifest_from_bytes(data[_MANIFEST_SIZE.size : _MANIFEST_SIZE.size + size])
    end = _MANIFEST_SIZE.size + size + manifest.side_info_bytes
    return manifest, data[_MANIFEST_SIZE.size + size : end], _bundled_packets(data[end:])


def _bundled_packets(data: bytes) -> tuple[bytes, ...]:
    """Splits the end of an init segment into the bundled packets. Each follows its size (u16)."""
    packets, offset = [], 0
    while offset < len(data):
        size = _PACKET_SIZE.unpack_from(data, offset)[0] if offset + _PACKET_SIZE.size <= len(data) else len(data)
        offset += _PACKET_SIZE.size + size
        if offset > len(data):
            raise BitstreamError("the init segment ends within a packet")
        packets.append(data[offset - size : offset])
    return tuple(packets)


class SourceBlocks(NamedTuple):
    """Division of the init segment into source blocks of nearly equal size, which are coded separately (erasure code).

    Attributes:
        num_bytes: Size of the init segment in bytes.
        symbol_bytes: Size of a symbol in bytes.
    """

    num_bytes: int
    symbol_bytes: int

    @property
    def num_symbols(self) -> int:
        """Number of source symbols of the whole init segment."""
        return num_symbols(self.num_bytes, self.symbol_bytes)

    @property
    def num_blocks(self) -> int:
        """Number of source blocks into which the init segment is divided."""
        return -(-self.num_symbols // MAX_SYMBOLS)

    def size(self, source_block: int) -> int:
        """Returns the number of source symbols in a source block.

        Args:
            source_block: Index of the source block, from 0.
        """
        return (
            self.num_symbols * (source_block + 1) // self.num_blocks
            - self.num_symbols * source_block // self.num_blocks
        )

    def span(self, source_block: int) -> slice:
        """Returns the bytes that a source block covers, as a slice of the init segment.

        Args:
            source_block: Index of the source block, from 0.
        """
        first = self.num_symbols * source_block // self.num_blocks
        end = first + self.size(source_block)
        return slice(first * self.symbol_bytes, min(end * self.symbol_bytes, self.num_bytes))


class ParityGroup(NamedTuple):
    """Parity group: packets with the indices `start + n * step`, which share repair symbols.

    Attributes:
        start: Index of the group's first packet in sending order.
        step: Difference between the indices of successive packets of the group. The packets with indices in between
            belong to other groups.
        size: Number of packets of the group.
        repair: Number of repair symbols of the group.
    """

    start: int
    step: int
    size: int
    repair: int

    def packet_of(self, symbol: int) -> int:
        """Returns the index in sending order of a packet of the group.

        Args:
            symbol: Index of the packet in the group (symbol index of the erasure code), 0 to `size - 1`.
        """
        return self.start + symbol * self.step


def parity_groups(parity_ranges: Sequence[ParityRange]) -> list[ParityGroup]:
    """Returns the parity groups (packets that share repair symbols) of a stream.

    Args:
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
    """
    finder = ParityGroupFinder(parity_ranges)
    return [finder.group(number) for number in range(finder.num_groups)]


class ParityGroupFinder:
    """Finds the parity group (packets that share repair symbols) of a packet.

    Args:
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
    """

    def __init__(self, parity_ranges: Sequence[ParityRange]) -> None:
        # Groups are computed from the ranges at each call: a table of all groups would need much memory
        self._ranges = tuple(parity_ranges)
        self.num_groups = sum(parity_range.groups for parity_range in self._ranges)

    def group(self, number: int) -> ParityGroup:
        """Returns the parity group with the given index, 0 to `num_groups - 1`."""
        first = 0
        for parity_range in self._ranges:
            if number < parity_range.groups:
                break
            first, number = first + parity_range.num_packets, number - parity_range.groups
        else:
            raise IndexError("there is no such parity group")
        return ParityGroup(
            first + number,
            parity_range.groups,
            -(-(parity_range.num_packets - number) // parity_range.groups),
            parity_range.repair,
        )

    def find(self, index: int) -> tuple[int, int] | None:
        """Finds the parity group of a packet.

        Args:
            index: Index of the packet in sending order.

        Returns:
            Index of the parity group, and index of the packet in the group; None for a packet without parity.
        """
        first = group = 0
        for parity_range in self._ranges:
            if index < first + parity_range.num_packets:
                if not parity_range.groups or not parity_range.repair:
                    return None
                symbol, offset = divmod(index - first, parity_range.groups)
                return group + offset, symbol
            first, group = first + parity_range.num_packets, group + parity_range.groups
        return None
