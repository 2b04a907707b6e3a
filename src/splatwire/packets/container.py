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

from splatwire.errors import BitstreamError, MissingSideInfoError, TruncatedStreamError, UnsupportedVersionError
from splatwire.packets.intake import PacketIntake, ReadReport
from splatwire.packets.manifest import MAX_MANIFEST_BYTES, Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.packets.packet import HEADER_BYTES, MAX_PACKET_BYTES, packet_mark
from splatwire.packets.scene_stream import FILE_MAGIC, FILE_PREFIX, FILE_VERSION, RECORD_PREFIX, SceneStream

RESYNC_EFFORT = 4
"""Damaged stretches may cost checksums over this many times the file's size before the reader gives up on the rest."""


def stream_to_bytes(stream: SceneStream) -> bytes:
    """Writes a stream as one file's bytes; `SceneStream.num_bytes` of them."""
    manifest = manifest_to_bytes(stream.manifest)
    pieces = [FILE_PREFIX.pack(FILE_MAGIC, FILE_VERSION, len(manifest)), manifest, stream.side_info]
    for packet in stream.packets:
        pieces += [RECORD_PREFIX.pack(packet.num_bytes), packet.data]
    return b"".join(pieces)


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
    view = memoryview(data)
    if bytes(view[: len(FILE_MAGIC)]) != FILE_MAGIC[: len(view)] or not len(view):
        raise BitstreamError(f"{name} is not a splatwire stream: it does not begin with its magic bytes")
    if len(view) < FILE_PREFIX.size:
        raise TruncatedStreamError(f"{name} ends after {len(view)} bytes, within its first header")
    _, version, manifest_bytes = FILE_PREFIX.unpack_from(view)
    if version != FILE_VERSION:
        raise UnsupportedVersionError(f"{name} has layout version {version}, this release reads {FILE_VERSION}")
    if manifest_bytes > MAX_MANIFEST_BYTES:
        raise BitstreamError(f"{name} is damaged: its manifest cannot have {manifest_bytes} bytes")
    body = FILE_PREFIX.size + manifest_bytes
    if len(view) < body:
        raise TruncatedStreamError(f"{name} ends after {len(view)} bytes, within its manifest")
    manifest = manifest_from_bytes(bytes(view[FILE_PREFIX.size : body]), f"the manifest of {name}")
    side_info = bytes(view[body : body + manifest.side_info_bytes])
    check_side_info(manifest, side_info, f"the side information of {name}")
    intake = PacketIntake(manifest)
    _read_records(data, body + len(side_info), manifest.stream_id, intake)
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


def _read_records(data: bytes, position: int, stream_id: int, intake: PacketIntake) -> None:
    """Offers every record to the intake, looking for the next packet's first bytes after each damaged one."""
    view, mark = memoryview(data), packet_mark(stream_id)
    effort = RESYNC_EFFORT * len(data)
    while position < len(data):
        source, end, num_corrupt = f"byte {position}", _record_end(data, position), intake.num_corrupt
        if effort < 0:
            intake.count("corrupt", f"{source}: too much is damaged, the rest is not read")
            return
        if end is None:
            intake.count("corrupt", f"{source}: a packet is cut, or its size is damaged")
        else:
            intake.offer(view[position + RECORD_PREFIX.size : end], source)
            if intake.num_corrupt == num_corrupt:
                position = end
                continue
            effort -= end - position
        found = data.find(mark, position + RECORD_PREFIX.size + 1)
        if found < 0:
            return
        position = found - RECORD_PREFIX.size


def _record_end(data: bytes, position: int) -> int | None:
    """End of the record at a position, or None if its size cannot be true."""
    start = position + RECORD_PREFIX.size
    if start > len(data):
        return None
    (size,) = RECORD_PREFIX.unpack_from(data, position)
    return start + size if HEADER_BYTES <= size <= min(MAX_PACKET_BYTES, len(data) - start) else None
