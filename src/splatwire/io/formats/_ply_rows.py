"""Reader of the rows of PLY elements: binary of either byte order, or text."""

import logging
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.mmap_array import large_empty
from splatwire.io.formats._ply_header import PlyHeader

LOG = logging.getLogger(__name__)
_BLOCK_NUMBERS = 1 << 16
_MAX_WORD = 64
_LINE_ENDS = b"\r\n"
"""Bytes that some programs write after the last row of a binary file."""
_MIN_ROWS = 16
"""Minimum number of rows for which a multiple of them is unlikely to be the length of something else."""
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
        DatasetError: If there are fewer bytes than the rows need. Also if the number of additional bytes shows that the
            rows are probably longer than the header states.
    """
    expected, num_received, num_more = header.num_bytes, 0, 0
    data = large_empty((expected,), np.uint8)
    while num_received < expected or header.list_element is None:
        piece = next(source, b"")
        if not piece:
            break
        part = piece[: expected - num_received]
        data[num_received : num_received + len(part)] = np.frombuffer(part, np.uint8)
        num_received += len(part)
        num_more += len(piece) - len(part) if piece[len(part) :].strip(_LINE_ENDS) or num_more else 0
    if num_received < expected:
        raise _wrong_length(path, header, early=True)
    if header.list_element is None:
        _check_trailing_data(path, header, num_more, "bytes")
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
        DatasetError: If there are fewer numbers than the rows need, or a word of a row is not a number. Also if the
            number of additional words shows that the rows are probably longer than the header states.
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
    if header.list_element is None:
        _check_trailing_data(path, header, numbers.num_left(), "words")
    return elements


def _check_trailing_data(path: Path, header: PlyHeader, num_more: int, unit: str) -> None:
    """Logs a warning about content after the last row of a PLY.

    Args:
        path: The file, for messages.
        header: The parsed header.
        num_more: Number of bytes or words after the last row.
        unit: `bytes` or `words`.

    Raises:
        DatasetError: If the rows probably have more properties than the header names: `num_more` is then a multiple of
            the number of rows of the largest element.
    """
    if not num_more:
        return
    most = max((count for count, _ in header.elements.values()), default=0)
    if most >= _MIN_ROWS and num_more % most == 0:
        raise _wrong_length(path, header, early=False)
    LOG.warning(
        "%s: %s %s after the last row are not read: the file may be damaged, or several files in one",
        path, f"{num_more:,}", unit,
    )  # fmt: skip


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

    def num_left(self) -> int:
        """Returns the number of words that remain."""
        count, in_word = len(self._words) - self._at, False
        for piece in chain([self._rest], self._source):
            count += len(piece.split()) - (in_word and not piece[:1].isspace())
            in_word = not piece[-1:].isspace() if piece else in_word
        return count

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
