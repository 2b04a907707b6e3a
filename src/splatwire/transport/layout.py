"""Arithmetic that both ends share: how the head object is cut, and which packets a parity group protects."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from splatwire.errors import BitstreamError
from splatwire.packets.limits import MAX_MANIFEST_BYTES
from splatwire.packets.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.transport.fec import MAX_SYMBOLS, num_symbols
from splatwire.transport.frames import TierHead

_HEAD = struct.Struct("<I")
_CARRIED = struct.Struct("<H")


def head_object(manifest: Manifest, side_info: bytes, packets: Sequence[bytes] = ()) -> bytes:
    """Manifest and side information in one: everything that must arrive before a packet can be decoded.

    Args:
        manifest: The manifest.
        side_info: The side information.
        packets: Packets that share its protection: the first ones in sending order, each behind its size.
    """
    data = manifest_to_bytes(manifest)
    carried = b"".join(_CARRIED.pack(len(packet)) + packet for packet in packets)
    return _HEAD.pack(len(data)) + data + side_info + carried


def carried_bytes(packet_bytes: int, count: int) -> int:
    """What some packets add to the head object.

    Args:
        packet_bytes: Bytes of all of them.
        count: How many they are.
    """
    return packet_bytes + count * _CARRIED.size


def split_head_object(data: bytes) -> tuple[Manifest, bytes, tuple[bytes, ...]]:
    """Inverse of `head_object`.

    Raises:
        BitstreamError: If it is something else.
    """
    if len(data) < _HEAD.size:
        raise BitstreamError("the head object is cut")
    (size,) = _HEAD.unpack_from(data)
    if size > MAX_MANIFEST_BYTES or _HEAD.size + size > len(data):
        raise BitstreamError(f"the head object's manifest cannot have {size} bytes")
    manifest = manifest_from_bytes(data[_HEAD.size : _HEAD.size + size])
    end = _HEAD.size + size + manifest.side_info_bytes
    return manifest, data[_HEAD.size + size : end], _carried(data[end:])


def _carried(data: bytes) -> tuple[bytes, ...]:
    packets, at = [], 0
    while at < len(data):
        size = _CARRIED.unpack_from(data, at)[0] if at + _CARRIED.size <= len(data) else len(data)
        at += _CARRIED.size + size
        if at > len(data):
            raise BitstreamError("the head object ends within a packet")
        packets.append(data[at - size : at])
    return tuple(packets)


class Segments(NamedTuple):
    """The head object in segments, each a source block of the erasure code.

    Attributes:
        num_bytes: Bytes of the object.
        symbol_bytes: Bytes of a symbol.
    """

    num_bytes: int
    symbol_bytes: int

    @property
    def num_symbols(self) -> int:
        """Source symbols of all segments."""
        return num_symbols(self.num_bytes, self.symbol_bytes)

    @property
    def num_segments(self) -> int:
        """Number of segments."""
        return -(-self.num_symbols // MAX_SYMBOLS)

    def size(self, segment: int) -> int:
        """Source symbols of one segment; as equal as possible."""
        return self.num_symbols * (segment + 1) // self.num_segments - self.num_symbols * segment // self.num_segments

    def span(self, segment: int) -> slice:
        """Bytes of the object that a segment holds."""
        first = self.num_symbols * segment // self.num_segments
        last = first + self.size(segment)
        return slice(first * self.symbol_bytes, min(last * self.symbol_bytes, self.num_bytes))


class Group(NamedTuple):
    """A parity group: packets `start + n * step` for n below `size`.

    Attributes:
        start: Index of its first packet in sending order.
        step: From one to the next: neighbours in sending order are in different groups, so that a burst hits many.
        size: Packets, the source symbols of its code.
        repair: Repair symbols.
    """

    start: int
    step: int
    size: int
    repair: int

    def packet_of(self, symbol: int) -> int:
        """Packet of a source symbol."""
        return self.start + symbol * self.step


def parity_groups(tiers: Sequence[TierHead]) -> list[Group]:
    """All groups of all tiers, in order."""
    finder = GroupFinder(tiers)
    return [finder.group(number) for number in range(finder.num_groups)]


class GroupFinder:
    """Finds the group of a packet; a declaration of millions of groups takes no memory.

    Args:
        tiers: Protection of all packets.
    """

    def __init__(self, tiers: Sequence[TierHead]) -> None:
        self._tiers = tuple(tiers)
        self.num_groups = sum(tier.groups for tier in self._tiers)

    def group(self, number: int) -> Group:
        """One of the `num_groups` groups."""
        first = 0
        for tier in self._tiers:
            if number < tier.groups:
                break
            first, number = first + tier.num_packets, number - tier.groups
        else:
            raise IndexError("there is no such parity group")
        return Group(first + number, tier.groups, -(-(tier.num_packets - number) // tier.groups), tier.repair)

    def find(self, index: int) -> tuple[int, int] | None:
        """Group and source symbol of a packet; None if it has no parity."""
        first = group = 0
        for tier in self._tiers:
            if index < first + tier.num_packets:
                if not tier.groups or not tier.repair:
                    return None
                symbol, offset = divmod(index - first, tier.groups)
                return group + offset, symbol
            first, group = first + tier.num_packets, group + tier.groups
        return None
