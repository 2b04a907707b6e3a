"""Reader of safetensors files without mapping them into memory.

Mapping is avoided because another program may truncate the file. The operating system then ends each process that
accesses the mapped file (SIGBUS).
"""

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.errors import BitstreamError
from splatwire.files.kinds import format_error
from splatwire.files.read_limited import open_regular

_DTYPES = {
    "F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "u1", "BOOL": "?",
}  # fmt: skip
"""numpy dtype of each supported type name."""
_METADATA = "__metadata__"
_SIZE_BYTES = 8
_MAX_HEADER_BYTES = 8 << 20
"""Maximum size of the JSON header, bytes. Headers of real checkpoints are far smaller. In memory, JSON takes up to 25
times its size.
"""
_MAX_DIMENSIONS = 32
"""Maximum number of dimensions of a tensor, as in NumPy 1."""


class TensorFile:
    """An open safetensors file, from which tensors are read one by one.

    Args:
        path: Path of the file, for messages.
        file: The open file.

    Raises:
        BitstreamError: If the header is damaged, or the file is shorter or longer than its tensors.
        OSError: If the file cannot be read.

    Attributes:
        metadata: Texts of the header by name.
        header_bytes: Number of bytes before the tensors.
    """

    def __init__(self, path: Path, file: BufferedReader) -> None:
        self._path, self._file = path, file
        size = int.from_bytes(self._read(0, _SIZE_BYTES).tobytes(), "little")
        if size > self._file_bytes():
            raise BitstreamError(format_error(path, "a safetensors file"))
        if size > _MAX_HEADER_BYTES:
            raise self._error(f"its header has {size:,} bytes, at most {_MAX_HEADER_BYTES:,} are read")
        self.header_bytes = _SIZE_BYTES + size
        text = self._read(_SIZE_BYTES, size).tobytes()
        try:
            header = json.loads(text.decode("utf-8"), object_pairs_hook=self._object, parse_constant=_no_constant)
        except (ValueError, RecursionError) as error:
            raise self._error("its header is no JSON") from error
        if not isinstance(header, dict):
            raise self._error("its header is no JSON object")
        texts = header.pop(_METADATA, None)
        texts = {} if texts is None else texts
        if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
            raise self._error(f"{_METADATA} does not hold texts by name")
        self.metadata: dict[str, str] = texts
        self._entries = {name: self._entry(name, entry) for name, entry in header.items()}
        self._check_offsets()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the tensors, in the order of the header."""
        return tuple(self._entries)

    def shape(self, name: str) -> tuple[int, ...]:
        """Returns the shape of a tensor without reading it."""
        return self._entries[name][1]

    def type_name(self, name: str) -> str:
        """Returns the type of a tensor, such as `F32`."""
        return self._entries[name][0]

    def num_bytes(self, name: str) -> int:
        """Returns the size of a tensor in bytes."""
        _, _, start, stop = self._entries[name]
        return stop - start

    def tensor(self, name: str) -> np.ndarray:
        """Reads a tensor into memory.

        Raises:
            BitstreamError: If the file was truncated meanwhile.
            OSError: If the file cannot be read.
        """
        type_name, shape, start, stop = self._entries[name]
        data = self._read(self.header_bytes + start, stop - start)
        return data.view(_DTYPES[type_name]).reshape(shape)

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """Converts the fields of a JSON object of the header to a dictionary.

        Raises:
            BitstreamError: If two fields have the same name.
        """
        fields: dict[str, Any] = {}
        for name, value in pairs:
            if name in fields:  # some readers would use the first, others the second
                raise self._error(f"its header has {name[:80]!r} twice")
            fields[name] = value
        return fields

    def _entry(self, name: str, entry: Any) -> tuple[str, tuple[int, ...], int, int]:
        """Checks a tensor's entry in the header, and returns the content of the entry.

        Args:
            name: Name of the tensor.
            entry: The entry, a JSON object.

        Returns:
            Four values: type of the tensor, shape of the tensor, start of its data, and end of its data. Start and end
            are byte offsets from the end of the header.
        """
        fields = entry if isinstance(entry, dict) else {}
        type_name: Any = fields.get("dtype")
        shape: Any = fields.get("shape")
        offsets: Any = fields.get("data_offsets")
        numbers = [*(shape if isinstance(shape, list) else [-1]), *(offsets if isinstance(offsets, list) else [-1])]
        if any(type(number) is not int or not 0 <= number < 1 << 63 for number in numbers) or len(offsets) != 2:
            raise self._error(f"tensor {name[:80]!r} has no valid shape and offsets")
        if len(shape) > _MAX_DIMENSIONS:
            raise self._error(f"tensor {name[:80]!r} has {len(shape)} dimensions, at most {_MAX_DIMENSIONS} are read")
        if not isinstance(type_name, str) or type_name not in _DTYPES:
            raise self._error(f"tensor {name[:80]!r} is of type {type_name!r:.20}, which is not read")
        size = item_bytes = np.dtype(_DTYPES[type_name]).itemsize
        for length in shape:
            size *= length
        if not size and item_bytes * math.prod(length for length in shape if length) >= 1 << 63:
            raise self._error(f"tensor {name[:80]!r} has no bytes, but a shape that is too large")
        if offsets[1] - offsets[0] != size:
            raise self._error(f"tensor {name[:80]!r} has {offsets[1] - offsets[0]} bytes, its shape needs {size}")
        return type_name, tuple(shape), offsets[0], offsets[1]

    def _check_offsets(self) -> None:
        """Checks that tensors follow one another without gaps up to the end of the file."""
        end = 0
        for start, stop in sorted((start, stop) for _, _, start, stop in self._entries.values()):
            if start != end:
                raise self._error("its tensors overlap or leave a gap")
            end = stop
        size = self._file_bytes()
        if self.header_bytes + end != size:
            raise self._error(f"it has {size:,} bytes, its tensors need {self.header_bytes + end:,}")

    def _file_bytes(self) -> int:
        """Returns the current size of the open file, bytes."""
        # Not the size at the path, where another file may have replaced this one.
        return os.fstat(self._file.fileno()).st_size

    def _read(self, offset: int, size: int) -> np.ndarray:
        """Reads bytes of the file, uint8 (size)."""
        if offset + size > self._file_bytes():
            raise self._error("it ends early")
        data, num_read = np.empty(size, np.uint8), 0
        self._file.seek(offset)
        while num_read < size:
            count = self._file.readinto(data[num_read:].data)
            if not count:
                raise self._error("it was truncated while it was read")
            num_read += count
        return data

    def _error(self, reason: str) -> BitstreamError:
        return BitstreamError(f"{self._path}: a damaged file of tensors: {reason}")


def _no_constant(text: str) -> None:
    """Refuses `NaN` and `Infinity`, which Python would read although they are not JSON."""
    raise ValueError(f"{text} is no JSON")


@contextmanager
def open_tensor_file(path: Path) -> Iterator[TensorFile]:
    """Context manager that opens a safetensors file.

    Raises:
        BitstreamError: If the path is not an ordinary file, or the file is damaged.
    """
    with open_regular(path, BitstreamError) as file:
        try:
            yield TensorFile(path, file)
        except OSError as error:
            raise BitstreamError(f"{path} cannot be read: {error.strerror or error}") from error
