"""Streams on disk: one `.swz` file, or a directory with one file per packet.

```
scene/                      scene.swz
  manifest.json               the same content, see `container`
  side_info.bin
  pak_lane0_s0.pak
  pak_lane1_s0.pak
  ...
```

The name of a `.pak` file states the packet's index within its block (`lane`) and the block (`s`). Deleting `.pak` files
is a valid way of losing packets. Writing is atomic: a reader sees the old stream or the new one.
"""

import logging
import os
from pathlib import Path

from splatwire.arguments import checked, checked_except
from splatwire.bitstream.container import check_side_info, stream_from_bytes, stream_from_file, stream_to_bytes
from splatwire.bitstream.glb import HEAD_BYTES, json_size, stream_location
from splatwire.bitstream.intake import PacketIntake, ReadReport
from splatwire.bitstream.limits import MAX_MANIFEST_BYTES, MAX_PACKET_BYTES
from splatwire.bitstream.manifest import manifest_from_bytes, manifest_to_bytes
from splatwire.bitstream.packet_id import PacketId
from splatwire.bitstream.scene_stream import FILE_MAGIC, SceneStream
from splatwire.errors import BitstreamError, InvalidValueError, MissingSideInfoError, check_kind
from splatwire.files.atomic_write import atomic_output, is_unfinished, remove_unfinished
from splatwire.files.kinds import (
    GAUSSIAN_SUFFIXES,
    NOTHING,
    STREAM,
    STREAM_GLB,
    STREAMS,
    file_kind,
    format_error,
    opened,
)
from splatwire.files.names import path_of, real_path
from splatwire.files.read_limited import open_regular, read_at_most, read_limited

FILE_SUFFIX = ".swz"
MANIFEST_NAME = "manifest.json"
SIDE_INFO_NAME = "side_info.bin"
PACKET_SUFFIX = ".pak"
_LOG = logging.getLogger(__name__)


@checked_except("stream")
def write_stream(stream: SceneStream, path: str | os.PathLike[str]) -> None:
    """Writes a stream: one file if the path ends in `.swz`, otherwise a directory.

    Args:
        stream: The stream, complete or not.
        path: Destination. An existing stream is replaced.

    Raises:
        InvalidValueError: If `stream` is not a stream, `path` is not a path or has the suffix of a file of Gaussians,
            or its folder does not exist.
        BitstreamError: If the destination exists and is not a stream; it is left unchanged.
        OSError: If writing fails.
    """
    check_kind(stream, SceneStream, "read_stream")
    target = real_path(path_of(path, "a stream"))
    is_file = target.suffix.lower() == FILE_SUFFIX
    if target.suffix.lower() in GAUSSIAN_SUFFIXES:
        raise InvalidValueError(
            f"{target}: the name says a file of Gaussians, which `save_scene` writes; a stream is a {FILE_SUFFIX} file "
            "or a folder"
        )
    _check_replaceable(target, is_file)
    with atomic_output(target) as new:
        if is_file:
            new.write_bytes(stream_to_bytes(stream))
        else:
            _write_directory(stream, new)


@checked
def is_stream(path: Path) -> bool:
    """True if a path is a stream file or a stream directory.

    Raises:
        BitstreamError: If the path does not exist.
    """
    kind = file_kind(path)
    if kind == NOTHING:
        raise BitstreamError(format_error(path, "a stream"))
    return kind in STREAMS


@checked
def read_stream(path: str | os.PathLike[str]) -> tuple[SceneStream, ReadReport]:
    """Reads a stream from a file or a directory; damaged packets are counted as losses.

    Args:
        path: A `.swz` file, a `.glb` file with a stream, or a stream directory.

    Returns:
        The stream with its valid packets, and a report on all others.

    Raises:
        InvalidValueError: If `path` is not a path.
        BitstreamError: If `path` does not contain a stream, or the manifest is damaged; the message names the file.
        TruncatedStreamError: If a file ends within the manifest.
        MissingSideInfoError: If the side information is missing, cut or damaged, or a folder has no manifest.
    """
    with opened(path_of(path, "a stream")) as source:
        stream, report = _read_directory(source) if source.is_dir() else _read_file(source)
    if (damage := report.damage) is not None:
        _LOG.warning("%s: %s", source, damage)
    return stream, report


def _read_file(source: Path) -> tuple[SceneStream, ReadReport]:
    kind = file_kind(source)
    if kind not in (STREAM, STREAM_GLB):
        raise BitstreamError(format_error(source, "a splatwire stream"))
    with open_regular(source, BitstreamError) as file:
        try:
            if kind == STREAM:
                return stream_from_file(file, str(source))
            text = file.read(json_size(file.read(HEAD_BYTES), str(source)))
            start, size = stream_location(text, str(source))
            file.seek(start)
            return stream_from_bytes(file.read(size), str(source))
        except OSError as error:
            raise BitstreamError(f"{source} cannot be read: {error.strerror}") from error


def _write_directory(stream: SceneStream, folder: Path) -> None:
    folder.mkdir()
    (folder / MANIFEST_NAME).write_bytes(manifest_to_bytes(stream.manifest))
    (folder / SIDE_INFO_NAME).write_bytes(stream.side_info)
    for packet in stream.packets:
        (folder / packet.id.filename).write_bytes(packet.data)


def _check_replaceable(target: Path, is_file: bool) -> None:
    """Checks that nothing but a stream is overwritten.

    Args:
        target: Path to write to.
        is_file: True if the new stream is one file, False if it is a directory.

    Raises:
        BitstreamError: If `target` exists and is not a stream of the same kind.
    """
    if not target.exists():
        return
    refusal = f"{target} exists and is not a splatwire stream; it is left alone"
    if is_file:
        if not target.is_file():
            raise BitstreamError(refusal)
        with target.open("rb") as file:
            if file.read(len(FILE_MAGIC)) not in (FILE_MAGIC, b""):
                raise BitstreamError(refusal)
        return
    if not target.is_dir():
        raise BitstreamError(f"{refusal} (only paths that end in {FILE_SUFFIX} are written as one file)")
    remove_unfinished(target)
    names = {entry.name for entry in target.iterdir()}
    foreign = sorted(n for n in names - {MANIFEST_NAME, SIDE_INFO_NAME} if not n.endswith(PACKET_SUFFIX))
    if foreign or (names and MANIFEST_NAME not in names):
        raise BitstreamError(f"{refusal} (it holds {', '.join(foreign[:3]) or 'no manifest.json'})")


def _read_directory(folder: Path) -> tuple[SceneStream, ReadReport]:
    try:
        names, unfinished = sorted(os.listdir(folder)), is_unfinished(folder)
    except OSError as error:
        raise BitstreamError(f"{folder} cannot be read: {error.strerror}") from error
    if unfinished:
        raise BitstreamError(format_error(folder, "a splatwire stream"))
    packet_names = [name for name in names if name.endswith(PACKET_SUFFIX)]
    if MANIFEST_NAME not in names:
        if packet_names or SIDE_INFO_NAME in names:
            raise MissingSideInfoError(f"{folder / MANIFEST_NAME} is missing")
        raise BitstreamError(format_error(folder, "a splatwire stream", f"it has no {MANIFEST_NAME}"))
    path = folder / MANIFEST_NAME
    manifest = manifest_from_bytes(read_limited(path, MAX_MANIFEST_BYTES, BitstreamError), str(path))
    path = folder / SIDE_INFO_NAME
    if SIDE_INFO_NAME not in names:
        raise MissingSideInfoError(f"{path} is missing")
    side_info = read_at_most(path, manifest.side_info_bytes + 1, BitstreamError)
    check_side_info(manifest, side_info, str(path))
    intake = PacketIntake(manifest)
    for name in packet_names:
        _add_file(intake, folder / name)
    return SceneStream(manifest, side_info, intake.packets), intake.report()


def _add_file(intake: PacketIntake, path: Path) -> None:
    try:
        expected = PacketId.from_filename(path.name)
        data = read_at_most(path, MAX_PACKET_BYTES + 1, BitstreamError)
    except (InvalidValueError, BitstreamError) as error:
        intake.count("corrupt", f"{path.name}: {error}")
        return
    intake.add_bytes(data, path.name, expected)
