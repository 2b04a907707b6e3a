"""A strict reader of binary little-endian PLY files: elements of scalar properties, no lists."""

import lzma
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.capped import open_regular
from splatwire.files.kinds import is_not

MAX_VERTICES = 20_000_000
_MAX_HEADER_BYTES = 65_536
_MAX_PROPERTIES = 1024
_MAX_ELEMENTS = 16
_MAX_LINE = 120
_MAX_RATIO = 1000
_CHUNK_BYTES = 1 << 20
_XZ_MEMORY_LIMIT = 256 << 20
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "float": "<f4",
    "double": "<f8",
    "float32": "<f4",
    "float64": "<f8",
}


@dataclass(frozen=True, eq=False)
class PlyElement:
    """The rows of one element of a PLY file.

    Attributes:
        path: Where they come from, for messages.
        name: Its name, `vertex` for most.
        rows: A record for each row, with a field for each property; floats are finite.
    """

    path: Path
    name: str
    rows: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each property, in the order of the file."""
        return self.rows.dtype.names or ()

    def columns(self, prefix: str, count: int | None = None) -> np.ndarray:
        """Returns the properties `{prefix}0`, `{prefix}1`, ... as float32 (N, count).

        Args:
            prefix: Their common name.
            count: How many there must be; any number from 1 when None.

        Raises:
            DatasetError: If they are not there, or not numbered from 0 without a gap.
        """
        found = self.count_of(prefix)
        wanted = [f"{prefix}{i}" for i in range(max(found, 1) if count is None else count)]
        if count is not None and found != count:
            raise DatasetError(f"{self.path}: {found} properties {prefix}*, expected {count}")
        return self.select(wanted)

    def count_of(self, prefix: str) -> int:
        """How many properties there are whose name is a prefix and a number."""
        return sum(name.startswith(prefix) and name[len(prefix) :].isdigit() for name in self.names)

    def select(self, wanted: list[str]) -> np.ndarray:
        """Returns the properties of these names as float32 (N, len(wanted)).

        Raises:
            DatasetError: If one of them is missing.
        """
        missing = [name for name in wanted if name not in self.names]
        if missing:
            raise DatasetError(f"{self.path}: property {missing[0]} is missing")
        columns = np.empty((len(self.rows), len(wanted)), np.float32)
        for place, name in enumerate(wanted):
            columns[:, place] = self.rows[name]
        return columns


def read_ply(path: Path) -> PlyElement:
    """Reads a file whose only element is `vertex` with float properties, unpacking it when its name ends in `.xz`.

    Raises:
        DatasetError: If it is something else, or what `read_ply_elements` raises.
    """
    elements = read_ply_elements(path)
    vertices = elements.pop("vertex", None)
    if vertices is None or elements:
        others = ", ".join(f"element {name} {len(element.rows)}" for name, element in elements.items())
        raise DatasetError(f"{path}: the only element must be 'vertex', there is {others or 'none'}")
    for name in vertices.names:
        dtype = vertices.rows.dtype[name]
        if dtype != np.dtype("<f4"):
            raise DatasetError(f"{path}: property {dtype} {name} of the vertex is no float property")
    return vertices


def read_ply_elements(path: Path) -> dict[str, PlyElement]:
    """Reads all elements of `path`, unpacking it when its name ends in `.xz`.

    Memory grows with the bytes that are really there, never with what the header promises.

    Returns:
        The elements by name, in the order of the file.

    Raises:
        DatasetError: If the file is absent, is not such a PLY, ends early, goes on for too long, or holds NaN or
            infinite values; the message names the file and the reason.
    """
    try:
        with open_regular(path, DatasetError) as file:
            return _read_elements(path, file, path.stat().st_size)
    except (OSError, lzma.LZMAError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


def _read_elements(path: Path, file: BinaryIO, file_bytes: int) -> dict[str, PlyElement]:
    packed = path.suffix == ".xz"
    source = _unpacked(path, file) if packed else _plain(file)
    head, body = _split_header(path, source)
    layout = _parse_header(path, head)
    expected = sum(count * dtype.itemsize for count, dtype in layout.values())
    if expected > (file_bytes * _MAX_RATIO if packed else file_bytes):
        raise DatasetError(
            f"{path}: the header promises {expected} bytes, which {file_bytes} bytes of file cannot hold"
        )
    data = bytearray(body)
    while len(data) <= expected and (piece := next(source, b"")):
        data += piece
    if len(data) != expected:
        what = "ends early" if len(data) < expected else "goes on after the last row"
        rows = ", ".join(f"{count} {name} rows of {dtype.itemsize} bytes" for name, (count, dtype) in layout.items())
        raise DatasetError(f"{path}: {what}: {rows} were promised")
    elements, at = {}, 0
    for name, (count, dtype) in layout.items():
        rows_of = np.frombuffer(data, dtype=dtype, count=count, offset=at)
        elements[name] = _finite(PlyElement(path, name, rows_of))
        at += count * dtype.itemsize
    return elements


def _finite(element: PlyElement) -> PlyElement:
    for name in element.names:
        column = element.rows[name]
        if column.dtype.kind == "f" and not np.isfinite(column).all():
            row = int(np.argmin(np.isfinite(column)))
            raise DatasetError(f"{element.path}: {element.name} {row} has {column[row]} as {name}")
    return element


def _split_header(path: Path, source: Iterator[bytes]) -> tuple[bytes, bytes]:
    data = b""
    while True:
        piece = next(source, b"")
        data += piece
        end = data.find(b"end_header\n")
        if end >= 0:
            return data[:end], data[end + len(b"end_header\n") :]
        if not piece or len(data) > _MAX_HEADER_BYTES:
            raise DatasetError(is_not(path, "a PLY file", f"no end_header in the first {len(data)} bytes"))


def _parse_header(path: Path, head: bytes) -> dict[str, tuple[int, np.dtype]]:
    """Number and type of the rows of each element."""
    try:
        lines = [line.strip() for line in head.decode("ascii").split("\n")]
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: the PLY header is not ASCII text") from error
    lines = [line for line in lines if line and not line.startswith(("comment", "obj_info"))]
    if odd := next((line for line in lines if len(line) > _MAX_LINE or not line.isprintable()), ""):
        raise DatasetError(f"{path}: {odd[:80]!r} is no line of a PLY header")
    if lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        why = f"it starts with {' / '.join(lines[:2])[:80]!r}"
        raise DatasetError(is_not(path, "a binary little-endian PLY file", why))
    elements: dict[str, tuple[int, list[tuple[str, str]]]] = {}
    fields: list[tuple[str, str]] = []
    for line in lines[2:]:
        words = line.split()
        if words[0] == "element":
            name, count = _element(path, line)
            fields = []
            if name in elements or len(elements) == _MAX_ELEMENTS:
                raise DatasetError(f"{path}: {line[:80]!r} is there twice, or more than {_MAX_ELEMENTS} elements")
            elements[name] = (count, fields)
        elif elements and len(words) == 3 and words[0] == "property" and words[1] in _TYPES:
            fields.append((words[2], _TYPES[words[1]]))
        else:
            raise DatasetError(f"{path}: expected a number or float property of the vertex, found {line[:80]!r}")
    for _, fields in elements.values() if elements else [(0, [])]:
        if not 0 < len({name for name, _ in fields}) == len(fields) <= _MAX_PROPERTIES:
            raise DatasetError(f"{path}: {len(fields)} properties (1 to {_MAX_PROPERTIES}, all different, are allowed)")
    return {name: (count, np.dtype(fields)) for name, (count, fields) in elements.items()}


def _element(path: Path, line: str) -> tuple[str, int]:
    words = line.split()
    if len(words) != 3 or not words[2].isdigit():
        raise DatasetError(f"{path}: {line[:80]!r} is no element (the only element must be 'vertex')")
    if len(words[2]) > 12 or int(words[2]) > MAX_VERTICES:
        raise DatasetError(f"{path}: {words[2][:20]} rows of {words[1][:40]} are more than the limit of {MAX_VERTICES}")
    return words[1], int(words[2])


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
