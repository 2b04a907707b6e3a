"""Reader of the rows of PLY elements: binary of either byte order, or text."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.mmap_array import large_empty
from splatwire.io.formats._ply_header import PlyHeader

_BLOCK_NUMBERS = 1 << 16
_MAX_WORD = 64
_AXES = ("x", "y", "z")
_FAR = 1000.0
"""Distance from 0 beyond which the declared precision of a text's positions is checked against their digits."""
_SAMPLE = 1 << 12


def binary_rows(path: Path, header: PlyHeader, source: Iterator[bytes]) -> dict[str, np.ndarray]:
    """Reads the rows of the elements of a binary PLY.

    Args:
        path: The file, for messages.
        header: The parsed header.
        source: The bytes after the header, in pieces.

    Returns:
        Structured array of the rows of each element, by name.

    Raises:
        DatasetError: If there are fewer or more bytes than the rows have.
    """
    expected, num_received = header.num_bytes, 0
    data = large_empty((expected,), np.uint8)
    while num_received <= expected and (piece := next(source, b"")):
        data[num_received : num_received + len(piece)] = np.frombuffer(piece, np.uint8)[: expected - num_received]
        num_received += len(piece)
    if num_received < expected or (num_received > expected and header.lists is None):
        raise _wrong_length(path, header, num_received < expected)
    elements, offset = {}, 0
    for name, (count, dtype) in header.elements.items():
        elements[name] = np.frombuffer(data, dtype=dtype, count=count, offset=offset)
        offset += count * dtype.itemsize
    return elements


def text_rows(path: Path, header: PlyHeader, source: Iterator[bytes]) -> dict[str, np.ndarray]:
    """Reads the rows of the elements of a text PLY.

    Positions far from 0 are float64 if the file has more digits than float32.

    Args:
        path: The file, for messages.
        header: The parsed header.
        source: The bytes after the header, in pieces.

    Returns:
        Structured array of the rows of each element, by name.

    Raises:
        DatasetError: If there are fewer or more numbers than expected, or a word is not a number.
    """
    numbers, elements = _Numbers(path, header, source), {}
    for name, (count, dtype) in header.elements.items():
        names = dtype.names or ()
        rows, block = np.empty(count, _with_wide_axes(dtype)), max(1, _BLOCK_NUMBERS // len(names))
        for start in range(0, count, block):
            stop = min(start + block, count)
            values = numbers.take((stop - start) * len(names)).reshape(-1, len(names))
            for index, field in enumerate(names):
                rows[field][start:stop] = _as_type(path, values[:, index], rows.dtype[field], field)
        elements[name] = rows if rows.dtype == dtype or _has_more_digits(rows) else rows.astype(dtype)
    if header.lists is None and not numbers.at_end():
        raise _wrong_length(path, header, early=False)
    return elements


def _with_wide_axes(dtype: np.dtype) -> np.dtype:
    """Returns a row type with float64 in place of float32 positions."""
    names = dtype.names or ()
    if not set(_AXES) <= set(names):
        return dtype
    return np.dtype([(n, "<f8" if n in _AXES and dtype[n].kind == "f" else dtype[n].str) for n in names])


def _has_more_digits(rows: np.ndarray) -> bool:
    """True if the file gives positions with more digits than float32 can represent."""
    sample = rows[:: max(1, -(-len(rows) // _SAMPLE))]
    values = np.concatenate([sample[axis] for axis in _AXES])
    values = values[(np.abs(values) > _FAR) & (np.abs(values) < np.finfo(np.float32).max)]
    narrow = values.astype(np.float32)
    return bool(((narrow != values) & (narrow.astype(str).astype(np.float64) != values)).any())


class _Numbers:
    """Sequential reader of the numbers in a text file."""

    def __init__(self, path: Path, header: PlyHeader, source: Iterator[bytes]) -> None:
        self._path, self._header, self._source = path, header, source
        self._words: list[bytes] = []
        self._at = 0
        self._rest = b""

    def take(self, count: int) -> np.ndarray:
        """Reads the next `count` numbers of the file, float64 (count).

        Raises:
            DatasetError: If the file has fewer numbers, or a word is not a number.
        """
        values = np.empty(count)
        done = 0
        while done < count:
            if self._at == len(self._words) and not self._more():
                raise _wrong_length(self._path, self._header, early=True)
            part = self._words[self._at : self._at + count - done]
            values[done : done + len(part)] = [self._number(word) for word in part]
            self._at += len(part)
            done += len(part)
        return values

    def at_end(self) -> bool:
        """Returns True if only white space remains."""
        return self._at == len(self._words) and not self._more()

    def _more(self) -> bool:
        """Reads from the file until the buffer contains a complete number.

        Returns:
            True if more data were read, False at the end of the file.
        """
        while True:
            piece = next(self._source, b"")
            data = self._rest + piece
            words = data.split()
            self._rest = words.pop() if piece and words and not data[-1:].isspace() else b""
            if len(self._rest) > _MAX_WORD:
                raise self._no_number(self._rest)
            self._words, self._at = words, 0
            if words or not piece:
                return bool(words)

    def _number(self, word: bytes) -> float:
        try:
            if len(word) <= _MAX_WORD:
                return float(word)
        except ValueError:
            pass
        raise self._no_number(word)

    def _no_number(self, word: bytes) -> DatasetError:
        return DatasetError(f"{self._path}: {word[:40].decode('ascii', 'replace')!r} stands where a number should be")


def _as_type(path: Path, values: np.ndarray, dtype: np.dtype, name: str) -> np.ndarray:
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return values.astype(dtype)
    limits = np.iinfo(dtype)
    odd = ~((values >= limits.min) & (values <= limits.max) & (values == np.floor(values)))
    if odd.any():
        raise DatasetError(f"{path}: {values[odd][0]} as {name} is no {dtype.name}")
    return values.astype(dtype)


def _wrong_length(path: Path, header: PlyHeader, early: bool) -> DatasetError:
    problem = "ends early" if early else "goes on after the last row"
    elements = header.elements.items()
    sizes = {
        name: f"{d.itemsize} bytes" if header.order else f"{len(d.names or ())} numbers" for name, (_, d) in elements
    }
    rows = ", ".join(f"{count} {name} rows of {sizes[name]}" for name, (count, _) in elements)
    return DatasetError(f"{path}: {problem}: {rows} were promised")
