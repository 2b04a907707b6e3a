"""A stream as the bytes of one file.

| bytes | content |
|---|---|
| 0-3 | `93 53 57 5A` |
| 4 | version of this layout, 1 |
| 5-8 | size of the manifest, little-endian |
| ... | manifest, side information (its size is in the manifest) |
| ... | packets, each behind its size in 4 bytes |

The packets are the bytes of the `.pak` files of the directory layout. After damaged bytes the reader looks for the
next packet's first bytes, so one damaged packet costs one packet.
"""

import hashlib
import io

from splatwire.errors import BitstreamError, MissingSideInfoError, TruncatedStreamError, UnsupportedVersionError
from splatwire.packets.intake import PacketIntake, ReadReport
from splatwire.packets.limits import MAX_MANIFEST_BYTES, MAX_PACKET_BYTES
from splatwire.packets.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.packets.packet import HEADER_BYTES, packet_mark
from splatwire.packets.scene_stream import FILE_MAGIC, FILE_PREFIX, FILE_VERSION, RECORD_PREFIX, SceneStream

RESYNC_EFFORT = 4
"""Damaged stretches may cost checksums over this many times the file's size before the reader gives up on the rest."""
SEARCH_BYTES = 1 << 20
"""Read at a time where the next packet is looked for."""


def stream_to_bytes(stream: SceneStream) -> bytes:
    """Writes a stream as one file's bytes; `SceneStream.num_bytes` of them."""
    head = file_head(stream.manifest, stream.side_info)
    return b"".join([head, *(file_record(packet.data) for packet in stream.packets)])


def file_head(manifest: Manifest, side_info: bytes) -> bytes:
    """What a file begins with; records of packets follow, in any order."""
    text = manifest_to_bytes(manifest)
    return FILE_PREFIX.pack(FILE_MAGIC, FILE_VERSION, len(text)) + text + side_info


def file_record(packet: bytes) -> bytes:
    """A packet as it stands in a file."""
    return RECORD_PREFIX.pack(len(packet)) + packet


def stream_from_bytes(data: bytes, name: str = "stream") -> tuple[SceneStream, ReadReport]:
    """Reads one file's bytes; damaged packets are counted losses.

    Args:
        data: The whole file, or what is left of it.
        name: Where the bytes are from, for error messages.

    Raises:
        BitstreamError: If it is something else, or its manifest is damaged.
        TruncatedStreamError: If it ends before its manifest does.
        UnsupportedVersionError: If a newer release wrote it.
        MissingSideInfoError: If its side information is damaged or cut.
    """
    return stream_from_file(io.BytesIO(data), name)


def stream_from_file(file: io.BufferedIOBase, name: str) -> tuple[SceneStream, ReadReport]:
    """Reads an open file from its beginning, as `stream_from_bytes` does.

    In memory are the good packets and the packet that is being read, however much else the file holds.
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
    """Compares side information with what the manifest says of it.

    Raises:
        MissingSideInfoError: If it is shorter, longer or different.
    """
    if len(side_info) != manifest.side_info_bytes:
        raise MissingSideInfoError(f"{name} has {len(side_info)} of {manifest.side_info_bytes} bytes")
    if hashlib.sha256(side_info).hexdigest() != manifest.side_info_digest:
        raise MissingSideInfoError(f"{name} is damaged: its digest does not match the manifest")


def _read_records(file: io.BufferedIOBase, size: int, position: int, stream_id: int, intake: PacketIntake) -> None:
    """Offers every record to the intake, looking for the next packet's first bytes after each damaged one."""
    mark, effort = packet_mark(stream_id), RESYNC_EFFORT * size
    while position < size:
        source, end, num_corrupt = f"byte {position}", _record_end(file, size, position), intake.num_corrupt
        if effort < 0:
            intake.count("corrupt", f"{source}: too much is damaged, the rest is not read")
            return
        if end is None:
            intake.count("corrupt", f"{source}: a packet is cut, or its size is damaged")
        else:
            intake.offer(file.read(end - position - RECORD_PREFIX.size), source)
            if intake.num_corrupt == num_corrupt:
                position = end
                continue
            effort -= end - position
        found = _find(file, mark, position + RECORD_PREFIX.size + 1)
        if found is None:
            return
        position = found - RECORD_PREFIX.size


def _record_end(file: io.BufferedIOBase, size: int, position: int) -> int | None:
    """End of the record at a position, or None if its size cannot be true; the file then stands at its packet."""
    start = position + RECORD_PREFIX.size
    if start > size:
        return None
    file.seek(position)
    (length,) = RECORD_PREFIX.unpack(file.read(RECORD_PREFIX.size))
    return start + length if HEADER_BYTES <= length <= min(MAX_PACKET_BYTES, size - start) else None


def _find(file: io.BufferedIOBase, mark: bytes, position: int) -> int | None:
    """Where these bytes are next, from a position on; a piece of the file at a time."""
    file.seek(position)
    kept = b""
    while piece := file.read(SEARCH_BYTES):
        joined = kept + piece
        at = joined.find(mark)
        if at >= 0:
            return position - len(kept) + at
        position, kept = position + len(piece), joined[1 - len(mark) :]
    return None
