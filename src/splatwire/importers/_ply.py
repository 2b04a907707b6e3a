"""A strict reader of binary little-endian PLY files whose only element is `vertex` with float properties."""

import lzma
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatwire.errors import DatasetError

MAX_VERTICES = 20_000_000
_MAX_HEADER_BYTES = 65_536
_MAX_PROPERTIES = 1024
_MAX_RATIO = 1000
_CHUNK_BYTES = 1 << 20
_XZ_MEMORY_LIMIT = 256 << 20


@dataclass(frozen=True, eq=False)
class PlyVertices:
    """The vertices of a PLY file.

    Attributes:
        path: Where they come from, for messages.
        names: Name of each property.
        values: float32 (N, properties), finite.
    """

    path: Path
    names: tuple[str, ...]
    values: np.ndarray

    def columns(self, prefix: str, count: int | None = None) -> np.ndarray:
        """Returns the properties `{prefix}0`, `{prefix}1`, ... as float32 (N, count).

        Args:
            prefix: Their common name.
            count: How many there must be; any number from 1 when None.

        Raises:
            DatasetError: If they are not there, or not numbered from 0 without a gap.
        """
        found = sum(name.startswith(prefix) and name[len(prefix) :].isdigit() for name in self.names)
        wanted = [f"{prefix}{i}" for i in range(max(found, 1) if count is None else count)]
        if count is not None and found != count:
            raise DatasetError(f"{self.path}: {found} properties {prefix}*, expected {count}")
        return self.select(wanted)

    def select(self, wanted: list[str]) -> np.ndarray:
        """Returns the properties of these names as float32 (N, len(wanted)).

        Raises:
            DatasetError: If one of them is missing.
        """
        missing = [name for name in wanted if name not in self.names]
        if missing:
            raise DatasetError(f"{self.path}: property {missing[0]} is missing")
        return np.ascontiguousarray(self.values[:, [self.names.index(name) for name in wanted]])


def read_ply(path: Path) -> PlyVertices:
    """Reads `path`, unpacking it when its name ends in `.xz`.

    Memory grows with the bytes that are really there, never with what the header promises.

    Raises:
        DatasetError: If the file is absent, is not such a PLY, ends early, goes on for too long, or holds NaN or
            infinite values; the message names the file and the reason.
    """
    try:
        with path.open("rb") as file:
            return _read_vertices(path, file, path.stat().st_size)
    except (OSError, lzma.LZMAError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


def _read_vertices(path: Path, file: BinaryIO, file_bytes: int) -> PlyVertices:
    packed = path.suffix == ".xz"
    source = _unpacked(path, file) if packed else _plain(file)
    head, body = _split_header(path, source)
    count, names = _parse_header(path, head)
    expected = count * len(names) * 4
    if expected > (file_bytes * _MAX_RATIO if packed else file_bytes):
        raise DatasetError(
            f"{path}: the header promises {expected} bytes, which {file_bytes} bytes of file cannot hold"
        )
    data = bytearray(body)
    while len(data) <= expected and (piece := next(source, b"")):
        data += piece
    if len(data) != expected:
        what = "ends early" if len(data) < expected else "goes on after the last vertex"
        raise DatasetError(f"{path}: {what}: {count} vertices of {4 * len(names)} bytes were promised")
    values = np.frombuffer(data, dtype="<f4").reshape(count, len(names))
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise DatasetError(f"{path}: vertex {row} has {values[row, column]} as {names[column]}")
    return PlyVertices(path, names, values)


def _split_header(path: Path, source: Iterator[bytes]) -> tuple[bytes, bytes]:
    data = b""
    while True:
        piece = next(source, b"")
        data += piece
        end = data.find(b"end_header\n")
        if end >= 0:
            return data[:end], data[end + len(b"end_header\n") :]
        if not piece or len(data) > _MAX_HEADER_BYTES:
            raise DatasetError(f"{path}: has no PLY header (no end_header in the first {len(data)} bytes)")


def _parse_header(path: Path, head: bytes) -> tuple[int, tuple[str, ...]]:
    try:
        lines = [line.strip() for line in head.decode("ascii").split("\n")]
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: the PLY header is not ASCII text") from error
    lines = [line for line in lines if line and not line.startswith(("comment", "obj_info"))]
    if lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise DatasetError(
            f"{path}: not a binary little-endian PLY file, it starts with {' / '.join(lines[:2])[:80]!r}"
        )
    element = lines[2].split() if len(lines) > 2 else []
    if len(element) != 3 or element[:2] != ["element", "vertex"] or not element[2].isdigit():
        raise DatasetError(f"{path}: the only element must be 'vertex'")
    if len(element[2]) > 12 or int(element[2]) > MAX_VERTICES:
        raise DatasetError(f"{path}: {element[2][:20]} vertices are more than the limit of {MAX_VERTICES}")
    names = []
    for line in lines[3:]:
        words = line.split()
        if len(words) != 3 or words[0] != "property" or words[1] not in ("float", "float32"):
            raise DatasetError(f"{path}: expected a float property of the vertex, found {line[:80]!r}")
        names.append(words[2])
    if not names or len(names) > _MAX_PROPERTIES or len(set(names)) != len(names):
        raise DatasetError(f"{path}: {len(names)} properties (1 to {_MAX_PROPERTIES}, all different, are allowed)")
    return int(element[2]), tuple(names)


def _plain(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(_CHUNK_BYTES):
        yield piece


def _unpacked(path: Path, file: BinaryIO) -> Iterator[bytes]:
    decoder = lzma.LZMADecompressor(format=lzma.FORMAT_XZ, memlimit=_XZ_MEMORY_LIMIT)
    while not decoder.eof:
        piece = file.read(_CHUNK_BYTES) if decoder.needs_input else b""
        if decoder.needs_input and not piece:
            raise DatasetError(f"{path}: the xz data end early")
        yield decoder.decompress(piece, max_length=_CHUNK_BYTES)
