"""Packet of a stream: the unit of loss, decodable without any other packet.

Only a motion packet also needs the keyframe Gaussians of its tracks, and with separated packaging a feature group needs
those before it.

A packet is a 16-byte header and a payload. The header does not contain the size of the packet: it is the size of the
file or datagram that contains the packet.

| bytes | field |
|---|---|
| 0 | format version, 1 |
| 1-4 | id of the stream (`Manifest.stream_id`) |
| 5 | packet with all attributes: bits 8-13 of `PacketId.index_in_block` in bits 2-7, others 0; else `part_byte(part)` |
| 6 | bits 0-7 of `PacketId.index_in_block` |
| 7-9 | `PacketId.block` |
| 10-11 | number of elements |
| 12-15 | CRC-32 of bytes 0-11 and the payload |

All numbers are little-endian.
"""

import struct
import zlib
from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.bitstream.limits import MAX_BLOCK_SIZE, MAX_BLOCKS, MAX_HASHED_BLOCK, MAX_LANES, MAX_PACKET_BYTES
from splatwire.bitstream.packet_id import PARTS, PacketId
from splatwire.errors import (
    CorruptPacketError,
    ForeignPacketError,
    InvalidValueError,
    TruncatedStreamError,
    UnsupportedVersionError,
    shown,
    whole_number,
)
from splatwire.reprs import summary_repr

PACKET_VERSION = 1
HEADER_BYTES = 16

_FIELDS = struct.Struct("<BIBBHBH")
_CHECKSUM = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet of a stream; created by `make_packet` or `packet_from_bytes`.

    Attributes:
        id: Id of the packet within the stream.
        num_elements: Number of elements, 1 to 65535.
        data: Header and payload, as transmitted.
    """

    id: PacketId
    num_elements: int
    data: bytes

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        if not (type(self.id) is PacketId and type(self.num_elements) is int and type(self.data) is bytes):
            check_fields(self)

    @property
    def payload(self) -> bytes:
        """Bytes after the packet header: the entropy-coded attributes of the elements."""
        return self.data[HEADER_BYTES:]

    @property
    def num_bytes(self) -> int:
        """Size of the packet with its header, bytes."""
        return len(self.data)


def part_byte(part: int) -> int:
    """Returns the header byte of a packet that contains a single attribute of its elements (separated packaging).

    Args:
        part: Index of the attribute in `PARTS`, 1 or more.
    """
    return (part - 1) // 3 * 4 + (part - 1) % 3 + 1


def make_packet(packet_id: PacketId, num_elements: int, payload: bytes, stream_id: int = 0) -> Packet:
    """Creates a packet with header and checksum.

    Args:
        packet_id: Id of the packet within the stream.
        num_elements: Number of elements, 1 to 65535.
        payload: Entropy-coded attributes of the elements.
        stream_id: Id of the stream, 32 bits.

    Raises:
        InvalidValueError: If a number does not fit the header, or the payload is too long.
    """
    if type(packet_id) is not PacketId or type(payload) is not bytes:  # no `checked`: called once per packet
        arguments = f"{shown(packet_id)}, {shown(payload)}"
        raise InvalidValueError(f"expected a PacketId as packet_id and bytes as payload, not {arguments}")
    if not (type(num_elements) is int and type(stream_id) is int):  # converts NumPy integers, refuses the rest
        num_elements, stream_id = whole_number(num_elements, "num_elements"), whole_number(stream_id, "stream_id")
    if not (1 <= num_elements <= MAX_BLOCK_SIZE and 0 <= stream_id < 1 << 32):
        whole_number(num_elements, "num_elements", 1, MAX_BLOCK_SIZE)
        whole_number(stream_id, "stream_id", 0, (1 << 32) - 1)
    fits = (
        0 <= packet_id.block < MAX_BLOCKS
        and 0 <= packet_id.index_in_block < (MAX_LANES if packet_id.part else MAX_HASHED_BLOCK)
        and 0 <= packet_id.part < len(PARTS)
        and HEADER_BYTES + len(payload) <= MAX_PACKET_BYTES
    )
    if not fits:
        raise InvalidValueError(f"no packet holds {packet_id} with {num_elements} elements and {len(payload)} bytes")
    block_high, block_low = divmod(packet_id.block, 1 << 16)
    index_high, index_low = divmod(packet_id.index_in_block, 1 << 8)
    part = part_byte(packet_id.part) if packet_id.part else index_high << 2
    fields = _FIELDS.pack(PACKET_VERSION, stream_id, part, index_low, block_low, block_high, num_elements)
    checksum = _CHECKSUM.pack(zlib.crc32(payload, zlib.crc32(fields)))
    return Packet(packet_id, num_elements, b"".join((fields, checksum, payload)))


def packet_from_bytes(data: bytes | memoryview, stream_id: int | None) -> Packet:
    """Parses a packet, and checks header and checksum.

    Args:
        data: Exactly one packet.
        stream_id: Expected id of the stream; None accepts any.

    Raises:
        TruncatedStreamError: If the data are shorter than a header.
        UnsupportedVersionError: If a newer release wrote the packet.
        CorruptPacketError: If the checksum fails, or a header field is out of range.
        ForeignPacketError: If the packet is intact but belongs to another stream.
    """
    if not isinstance(data, bytes | memoryview) or (stream_id is not None and type(stream_id) is not int):
        arguments = f"data {shown(data)}, stream_id {shown(stream_id)}"
        raise InvalidValueError(f"expected data as bytes and a stream_id as a whole number or None, not {arguments}")
    view = memoryview(data)
    if len(view) < HEADER_BYTES:
        raise TruncatedStreamError(f"a packet of {len(view)} bytes ends within its header of {HEADER_BYTES}")
    version, packet_stream_id, part, index_low, block_low, block_high, num_elements = _FIELDS.unpack_from(view)
    if version > PACKET_VERSION:
        raise UnsupportedVersionError(
            f"the packet has format version {version}, this release reads up to {PACKET_VERSION}"
        )
    part_number = 3 * (part >> 2) + (part & 3)
    has_all_attributes = part & 3 == 0
    if not has_all_attributes and part_number >= len(PARTS):
        raise CorruptPacketError("a packet", f"its header makes no sense (part {part_number})")
    index_in_block = (part >> 2 << 8 if has_all_attributes else 0) | index_low
    packet_id = PacketId(block_high << 16 | block_low, index_in_block, 0 if has_all_attributes else part_number)
    name = packet_id.filename
    if len(view) > MAX_PACKET_BYTES:
        raise CorruptPacketError(name, f"it has {len(view)} bytes, more than {MAX_PACKET_BYTES}")
    (checksum,) = _CHECKSUM.unpack_from(view, _FIELDS.size)
    if zlib.crc32(view[HEADER_BYTES:], zlib.crc32(view[: _FIELDS.size])) != checksum:
        raise CorruptPacketError(name, "its checksum does not match")
    if version < 1 or num_elements < 1:
        raise CorruptPacketError(name, f"its header makes no sense (version {version}, {num_elements} elements)")
    if stream_id is not None and packet_stream_id != stream_id:
        raise ForeignPacketError(name, f"it belongs to stream {packet_stream_id:08x}, not {stream_id:08x}")
    return Packet(packet_id, num_elements, bytes(view))


def packet_mark(stream_id: int) -> bytes:
    """Returns the first five bytes of every packet of a stream, used to find packets in damaged files."""
    return struct.pack("<BI", PACKET_VERSION, stream_id)
