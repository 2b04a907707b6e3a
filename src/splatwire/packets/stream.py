"""Streams on disk: one `.swz` file, or a directory in which every packet is a file of its own.

```
scene/                      scene.swz
  manifest.json               the same content, see `container`
  side_info.bin
  pak_lane0_s0.pak
  pak_lane1_s0.pak
  ...
```

Deleting `.pak` files is a valid way of losing packets. Writing is atomic: a reader sees the old stream or the new one.
"""

import os
import shutil
import stat
import uuid
from pathlib import Path

from splatwire.errors import BitstreamError, InvalidValueError, MissingSideInfoError
from splatwire.packets.container import check_side_info, stream_from_bytes, stream_to_bytes
from splatwire.packets.intake import PacketIntake, ReadReport
from splatwire.packets.manifest import MAX_MANIFEST_BYTES, manifest_from_bytes, manifest_to_bytes
from splatwire.packets.packet import MAX_PACKET_BYTES
from splatwire.packets.packet_id import PacketId
from splatwire.packets.scene_stream import FILE_MAGIC, SceneStream

FILE_SUFFIX = ".swz"
MANIFEST_NAME = "manifest.json"
SIDE_INFO_NAME = "side_info.bin"
PACKET_SUFFIX = ".pak"


def write_stream(stream: SceneStream, path: str | os.PathLike[str]) -> None:
    """Writes a stream; a path that ends in `.swz` becomes one file, any other a directory.

    Args:
        stream: The stream, complete or not.
        path: Where to. An existing stream there is replaced as a whole.

    Raises:
        BitstreamError: If something that is not a stream is there; it is left alone.
        OSError: If the disk refuses.
    """
    target = Path(path).resolve()
    is_file = target.suffix == FILE_SUFFIX
    _check_replaceable(target, is_file)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex[:12]}.tmp")
    try:
        if is_file:
            temporary.write_bytes(stream_to_bytes(stream))
            os.replace(temporary, target)
        else:
            _write_directory(stream, temporary)
            _replace_directory(temporary, target)
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def is_stream(path: Path) -> bool:
    """Tells streams from scene files by looking: a folder, or a file that begins with a stream's magic bytes.

    Raises:
        BitstreamError: If nothing is there.
    """
    if path.is_dir():
        return True
    if not path.is_file():
        raise BitstreamError(f"{path}: no such file or folder")
    with path.open("rb") as file:
        return file.read(len(FILE_MAGIC)) == FILE_MAGIC


def read_stream(path: str | os.PathLike[str]) -> tuple[SceneStream, ReadReport]:
    """Reads a stream in either form; damaged, foreign, duplicate or misnamed packets are counted losses.

    Args:
        path: A `.swz` file (under any name) or a stream directory.

    Returns:
        The stream with the packets that are good, and the count of those that are not.

    Raises:
        BitstreamError: If it is not a stream, or its manifest is damaged; the message names the file.
        MissingSideInfoError: If the manifest or the side information is missing, cut or damaged.
    """
    source = Path(path)
    if source.is_dir():
        return _read_directory(source)
    if not source.exists():
        raise BitstreamError(f"{source} does not exist")
    if not source.is_file():
        raise BitstreamError(f"{source} is neither a file nor a directory")
    if _read_capped(source, len(FILE_MAGIC) - 1) != FILE_MAGIC:  # look before reading what may be a whole disk image
        raise BitstreamError(f"{source} is not a splatwire stream: it does not begin with its magic bytes")
    return stream_from_bytes(_read_capped(source), str(source))


def _write_directory(stream: SceneStream, folder: Path) -> None:
    folder.mkdir()
    (folder / MANIFEST_NAME).write_bytes(manifest_to_bytes(stream.manifest))
    (folder / SIDE_INFO_NAME).write_bytes(stream.side_info)
    for packet in stream.packets:
        (folder / packet.id.filename).write_bytes(packet.data)


def _replace_directory(new: Path, target: Path) -> None:
    """Moves a finished directory into place, and what was there out of the way first: no old packet stays behind."""
    if not target.exists():
        new.rename(target)
        return
    old = new.with_name(f"{new.name}.old")
    target.rename(old)
    try:
        new.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old)


def _check_replaceable(target: Path, is_file: bool) -> None:
    """Refuses to overwrite what is not a stream: nobody loses photos to a mistyped path."""
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
    names = {entry.name for entry in target.iterdir()}
    foreign = sorted(n for n in names - {MANIFEST_NAME, SIDE_INFO_NAME} if not n.endswith(PACKET_SUFFIX))
    if foreign or (names and MANIFEST_NAME not in names):
        raise BitstreamError(f"{refusal} (it holds {', '.join(foreign[:3]) or 'no manifest.json'})")


def _read_directory(folder: Path) -> tuple[SceneStream, ReadReport]:
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise BitstreamError(f"{folder} cannot be read: {error.strerror}") from error
    packet_names = [name for name in names if name.endswith(PACKET_SUFFIX)]
    if MANIFEST_NAME not in names:
        if packet_names or SIDE_INFO_NAME in names:
            raise MissingSideInfoError(f"{folder / MANIFEST_NAME} is missing")
        raise BitstreamError(f"{folder} is not a splatwire stream: it has no {MANIFEST_NAME}")
    path = folder / MANIFEST_NAME
    manifest = manifest_from_bytes(_read_capped(path, MAX_MANIFEST_BYTES), str(path))
    path = folder / SIDE_INFO_NAME
    if SIDE_INFO_NAME not in names:
        raise MissingSideInfoError(f"{path} is missing")
    side_info = _read_capped(path, manifest.side_info_bytes)
    check_side_info(manifest, side_info, str(path))
    intake = PacketIntake(manifest)
    for name in packet_names:
        _offer_file(intake, folder / name)
    return SceneStream(manifest, side_info, intake.packets), intake.report()


def _offer_file(intake: PacketIntake, path: Path) -> None:
    try:
        expected = PacketId.from_filename(path.name)
        data = _read_capped(path, MAX_PACKET_BYTES)
    except (InvalidValueError, BitstreamError) as error:
        intake.count("corrupt", f"{path.name}: {error}")
        return
    intake.offer(data, path.name, expected)


def _read_capped(path: Path, limit: int | None = None) -> bytes:
    """Reads a regular file, at most one byte more than it may have.

    Raises:
        BitstreamError: If it is not a regular file (a pipe would block, a device never end), or cannot be read.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise BitstreamError(f"{path} is not a regular file")
        with path.open("rb") as file:
            return file.read() if limit is None else file.read(limit + 1)
    except OSError as error:
        raise BitstreamError(f"{path} cannot be read: {error.strerror}") from error
