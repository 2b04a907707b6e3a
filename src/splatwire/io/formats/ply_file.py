"""Strict reader of PLY files, binary or text. Only elements before the first one with list properties are read."""

import logging
import lzma
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import XZ_MAGIC
from splatwire.files.read_limited import open_regular
from splatwire.io.formats._ply_header import read_header
from splatwire.io.formats._ply_rows import binary_rows, text_rows

LOG = logging.getLogger(__name__)
_MAX_RATIO, _FREE_BYTES = 32, 16 << 20
"""Maximum decompression ratio of xz archives, and decompressed bytes accepted for archives of any size."""
_CHUNK_BYTES = 1 << 20
MAX_SAMPLE = 1 << 16
"""Maximum number of rows of an element that are examined to judge all (`PlyElement.sample`)."""
_XZ_MEMORY_LIMIT = 80 << 20
"""Memory limit of the decoder; archives of the highest preset need 65 MiB."""


@dataclass(frozen=True, eq=False)
class PlyElement:
    """All rows of one element of a PLY file, for example of the element `vertex`.

    Attributes:
        path: Path of the file, for messages.
        name: Name of the element, usually `vertex`.
        rows: Structured array with one field per property; floats may be NaN or infinite.
        comments: Text of each comment of the file's header.
    """

    path: Path
    name: str
    rows: np.ndarray
    comments: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the properties, in file order."""
        return self.rows.dtype.names or ()

    def sample(self) -> "PlyElement":
        """Returns an element with at most `MAX_SAMPLE` of the rows, evenly spaced."""
        return replace(self, rows=self.rows[:: max(1, -(-len(self.rows) // MAX_SAMPLE))])

    def columns(self, prefix: str, count: int | None = None) -> np.ndarray:
        """Returns the numbered properties `{prefix}0`, `{prefix}1`, … of all rows, float32 (N, count).

        Args:
            prefix: Common prefix of the names.
            count: Required number of properties; None for any number from 1.

        Raises:
            DatasetError: If properties are missing, or not numbered from 0 without a gap.
        """
        num_present = self.count_of(prefix)
        property_names = [f"{prefix}{i}" for i in range(max(num_present, 1) if count is None else count)]
        if count is not None and num_present != count:
            raise DatasetError(f"{self.path}: {num_present} properties {prefix}*, expected {count}")
        return self.select(property_names)

    def count_of(self, prefix: str) -> int:
        """Returns the number of properties whose name is the prefix followed by a number."""
        return sum(name.startswith(prefix) and name[len(prefix) :].isdigit() for name in self.names)

    def select(self, names: list[str]) -> np.ndarray:
        """Returns the named properties of all N rows, one column per name, float32 (N, len(names)).

        Raises:
            DatasetError: If a property is missing.
        """
        return self._select(names, np.float32)

    def select_float64(self, names: list[str]) -> np.ndarray:
        """Returns the named properties of all N rows, one column per name, float64 (N, len(names)).

        Raises:
            DatasetError: If a property is missing.
        """
        return self._select(names, np.float64)

    def _select(self, names: list[str], dtype: type[np.floating]) -> np.ndarray:
        missing = [name for name in names if name not in self.names]
        if missing:
            raise DatasetError(f"{self.path}: property {missing[0]} is missing")
        indices = [self.names.index(name) for name in names]
        first = indices[0] if indices else 0
        if self.rows.dtype == _float_row(self.names) and indices == list(range(first, first + len(indices))):
            # Neighbouring columns of float32: one strided copy takes a third of the time of a copy for each column.
            table = np.ascontiguousarray(self.rows).view(np.float32).reshape(len(self.rows), len(self.names))
            return table[:, first : first + len(indices)].astype(dtype)
        columns = np.empty((len(self.rows), len(names)), dtype)
        for index, name in enumerate(names):
            columns[:, index] = self.rows[name]
        return columns


def _float_row(names: tuple[str, ...]) -> np.dtype:
    """Returns the type of rows that have only float32 properties of this machine's byte order, without gaps."""
    return np.dtype([(name, np.float32) for name in names])


def read_ply(path: Path) -> PlyElement:
    """Reads a PLY file whose only element is `vertex`, with float properties.

    The file is binary, text, or an xz archive of a PLY file.

    Raises:
        DatasetError: If the file has other elements, or `read_ply_elements` fails.
    """
    elements = read_ply_elements(path)
    vertices = elements.pop("vertex", None)
    if vertices is None or elements:
        others = ", ".join(f"element {name} {len(element.rows)}" for name, element in elements.items())
        raise DatasetError(f"{path}: the only element must be 'vertex', there is {others or 'none'}")
    for name in vertices.names:
        dtype = vertices.rows.dtype[name]
        if dtype.kind != "f" or dtype.itemsize != 4:
            raise DatasetError(f"{path}: property {dtype} {name} of the vertex is no float property")
    return vertices


def read_ply_elements(path: Path) -> dict[str, PlyElement]:
    """Reads all elements of a PLY: binary of either byte order, text, or an xz archive of a PLY.

    An element with lists, such as the faces of a mesh, and all elements after it are skipped.

    Returns:
        The elements by name, in the order of the file.

    Raises:
        DatasetError: If the file is absent, is not such a PLY, or is too short or too long.
    """
    try:
        with open_regular(path, DatasetError) as file:
            return _read_elements(path, file, path.stat().st_size)
    except (OSError, lzma.LZMAError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


def _source(path: Path, file: BinaryIO, file_bytes: int) -> tuple[Iterator[bytes], int]:
    """Returns the content of a PLY file, decompressed if it is an xz archive.

    Args:
        path: Path of the file, for messages.
        file: The opened file.
        file_bytes: Size of the file in bytes.

    Returns:
        The bytes in pieces; and an upper limit on the number of bytes. The counts in the header are compared with this
        limit.
    """
    is_xz = file.read(len(XZ_MAGIC)) == XZ_MAGIC
    file.seek(0)
    limit = max(_FREE_BYTES, _MAX_RATIO * file_bytes) if is_xz else file_bytes
    return _unpacked(path, file, limit) if is_xz else _plain(file), limit


def _read_elements(path: Path, file: BinaryIO, file_bytes: int) -> dict[str, PlyElement]:
    source, limit = _source(path, file, file_bytes)
    header, body = read_header(path, source)
    if header.num_bytes > limit:
        raise DatasetError(
            f"{path}: the header promises {header.num_bytes} bytes, which {file_bytes} bytes of file cannot hold"
        )
    read = binary_rows if header.order else text_rows
    elements = read(path, header, chain([body] if body else [], source))
    if header.list_element is not None and "vertex" not in elements:
        if header.list_element == "vertex":
            names = ", ".join(header.list_properties)[:80]
            raise DatasetError(
                f"{path}: element vertex has list properties ({names}), and Gaussians have one number per property: "
                "remove the lists"
            )
        why = f"element {header.list_element} has lists, so neither it nor what follows is read"
        raise DatasetError(f"{path}: no vertices: {why}; write element vertex first")
    if header.unread:
        LOG.warning(
            "%s: elements %s follow the lists of element %s and are not read", path, ", ".join(header.unread)[:120],
            header.list_element,
        )  # fmt: skip
    return {name: PlyElement(path, name, rows, header.comments) for name, rows in elements.items()}


def _plain(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(_CHUNK_BYTES):
        yield piece


def _unpacked(path: Path, file: BinaryIO, limit: int) -> Iterator[bytes]:
    decoder = lzma.LZMADecompressor(format=lzma.FORMAT_XZ, memlimit=_XZ_MEMORY_LIMIT)
    num_left = limit
    while not decoder.eof:
        piece = file.read(_CHUNK_BYTES) if decoder.needs_input else b""
        if decoder.needs_input and not piece:
            raise DatasetError(f"{path}: the xz data end early")
        output = decoder.decompress(piece, max_length=_CHUNK_BYTES)
        num_left -= len(output)
        if num_left < 0:
            raise DatasetError(f"{path}: unpacks to more than {limit} bytes, which such an archive cannot need")
        if output:
            yield output
