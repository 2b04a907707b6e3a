"""The one-file layout of a stream.

| bytes | content |
|---|---|
| 0-3 | `93 53 57 5A` |
| 4 | version of this layout, 1 |
| 5-8 | size of the manifest, little-endian |
| ... | manifest, side information (its size is in the manifest) |
| ... | packets, each preceded by its size in 4 bytes, little-endian |

The packets are the bytes of the `.pak` files of the directory layout. After damaged bytes the reader searches for the
start of the next packet, so one damaged packet costs one packet.
"""

import hashlib
import io

from splatwire.arguments import checked
from splatwire.bitstream.intake import PacketIntake, ReadReport
from splatwire.bitstream.limits import MAX_MANIFEST_BYTES, MAX_PACKET_BYTES
from splatwire.bitstream.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.bitstream.packet import HEADER_BYTES, packet_mark
from splatwire.bitstream.scene_stream import FILE_MAGIC, FILE_PREFIX, FILE_VERSION, RECORD_PREFIX, SceneStream
from splatwire.errors import (
    BitstreamError,
    InvalidValueError,
    MissingSideInfoError,
    TruncatedStreamError,
    UnsupportedVersionError,
    shown,
)

RESYNC_EFFORT = 4
"""Maximum number of bytes to checksum in damaged regions, as a multiple of the file's size. If it is exceeded, the rest
of the file is skipped.
"""
SEARCH_BYTES = 1 << 20
"""Bytes read at a time while searching for the next packet."""


@checked
def stream_to_bytes(stream: SceneStream) -> bytes:
    """Serialises a stream as one file of `SceneStream.num_bytes` bytes."""
    head = file_head(stream.manifest, stream.side_info)
    return b"".join([head, *(file_record(packet.data) for packet in stream.packets)])


@checked
def file_head(manifest: Manifest, side_info: bytes) -> bytes:
    """Serialises the start of a stream file: prefix, manifest and side information."""
    text = manifest_to_bytes(manifest)
    return FILE_PREFIX.pack(FILE_MAGIC, FILE_VERSION, len(text)) + text + side_info


def file_record(packet: bytes) -> bytes:
    """Serialises one packet for a stream file: packet size (4 bytes), then packet bytes."""
    if not isinstance(packet, bytes):  # no `checked`: called once per packet
        raise InvalidValueError(f"packet: expected bytes, not {shown(packet)}")
    return RECORD_PREFIX.pack(len(packet)) + packet


@checked
def stream_from_bytes(data: bytes, name: str = "stream") -> tuple[SceneStream, ReadReport]:
    """Reads a stream from the bytes of a file; damaged packets are counted as losses.

    Args:
        data: The file's bytes, possibly truncated.
        name: Source of the bytes, for error messages.

    Raises:
        BitstreamError: If the bytes are not a stream, or the manifest is damaged.
        TruncatedStreamError: If the bytes end before the manifest does.
        UnsupportedVersionError: If a newer release wrote the file.
        MissingSideInfoError: If the side information is damaged or cut.
    """
    return stream_from_file(io.BytesIO(data), name)


def stream_from_file(file: io.BufferedIOBase, name: str) -> tuple[SceneStream, ReadReport]:
    """Reads a stream from an open file; damaged packets are counted as losses.

    Args:
        file: The open file, positioned anywhere.
        name: Source of the bytes, for error messages.

    Raises:
        BitstreamError: If the bytes are not a stream, or the manifest is damaged.
        TruncatedStreamError: If the file ends before the manifest does.
        UnsupportedVersionError: If a newer release wrote the file.
        MissingSideInfoError: If the side information is damaged or cut.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    head = file.read(FILE_PREFIX.size)
    if head[: len(FILE_MAGIC)] != FILE_MAGIC[: len(head)] or not head:
        raise BitstreamError(f"{name} is not a splatwire stream: it does not begin with its magic bytes")
    if len(head) < FILE_PREFIX.size:
        raise TruncatedStreamError(f"{name} ends after {size} bytes, within its first header")
    _, version, manifest_bytes = FILE_PREFIX.unpack(head)
    if version != FILE_VERSION:
        raise UnsupportedVersionError(f"{name} has layout version {version}, this release reads {FILE_VERSION}")
    if manifest_bytes > MAX_MANIFEST_BYTES:
        raise BitstreamError(f"{name} is damaged: its manifest cannot have {manifest_bytes} bytes")
    if size < FILE_PREFIX.size + manifest_bytes:
        raise TruncatedStreamError(f"{name} ends after {size} bytes, within its manifest")
    manifest = manifest_from_bytes(file.read(manifest_bytes), f"the manifest of {name}")
    side_info = file.read(manifest.side_info_bytes)
    check_side_info(manifest, side_info, f"the side information of {name}")
    intake = PacketIntake(manifest)
    _read_records(file, size, file.tell(), manifest.stream_id, intake)
    return SceneStream(manifest, side_info, intake.packets), intake.report()


def check_side_info(manifest: Manifest, side_info: bytes, name: str) -> None:
    """Checks that side information has the size and digest that the manifest states.

    Raises:
        MissingSideInfoError: If the size or the digest differs.
    """
    if len(side_info) != manifest.side_info_bytes:
        raise MissingSideInfoError(f"{name} has {len(side_info)} of {manifest.side_info_bytes} bytes")
    if hashlib.sha256(side_info).hexdigest() != manifest.side_info_digest:
        raise MissingSideInfoError(f"{name} is damaged: its digest does not match the manifest")


def _read_records(file: io.BufferedIOBase, size: int, position: int, stream_id: int, intake: PacketIntake) -> None:
    """Reads the packets of a stream file and passes each packet to `intake`.

    In the file, each packet follows a length field. Damaged bytes are skipped up to the next packet. The file is not
    read to its end if too much of it is damaged.

    Args:
        file: The open file, at `position`.
        size: Size of the file in bytes.
        position: Byte offset of the length field of the first packet.
        stream_id: Id of the stream. Every packet begins with bytes that contain this id. After damaged bytes, the next
            packet is found by these bytes.
        intake: Checks, collects and counts the packets.
    """
    mark, effort = packet_mark(stream_id), RESYNC_EFFORT * size
    while position < size:
        source, end, num_corrupt = f"byte {position}", _record_end(file, size, position), intake.num_corrupt
        if effort < 0:
            intake.count("corrupt", f"{source}: too much is damaged, the rest is not read")
            return
        if end is None:
            intake.count("corrupt", f"{source}: a packet is cut, or its size is damaged")
        else:
            intake.add_bytes(file.read(end - position - RECORD_PREFIX.size), source)
            if intake.num_corrupt == num_corrupt:
                position = end
                continue
            effort -= end - position
        next_mark = _find(file, mark, position + RECORD_PREFIX.size + 1)
        if next_mark is None:
            return
        position = next_mark - RECORD_PREFIX.size


def _record_end(file: io.BufferedIOBase, size: int, position: int) -> int | None:
    """Returns the byte position at which the packet at `position` of a stream file ends; None if its size is invalid.

    Args:
        file: The open file.
        size: Size of the file in bytes.
        position: Byte position of the packet's length field.
    """
    start = position + RECORD_PREFIX.size
    if start > size:
        return None
    file.seek(position)
    (length,) = RECORD_PREFIX.unpack(file.read(RECORD_PREFIX.size))
    return start + length if HEADER_BYTES <= length <= min(MAX_PACKET_BYTES, size - start) else None


def _find(file: io.BufferedIOBase, mark: bytes, position: int) -> int | None:
    """Returns the byte position of the next `mark` at or after `position`; None if no mark follows."""
    file.seek(position)
    kept = b""
    while piece := file.read(SEARCH_BYTES):
        joined = kept + piece
        index = joined.find(mark)
        if index >= 0:
            return position - len(kept) + index
        position, kept = position + len(piece), joined[1 - len(mark) :]
    return None
