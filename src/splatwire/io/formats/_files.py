"""Reading of slices of files, a check for files outside the folder of a scene, and warnings about unused bytes."""

import copy
import io
import logging
import os
import weakref
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.mmap_array import large_empty
from splatwire.files.read_limited import open_regular

LOG = logging.getLogger(__name__)
_MAX_READ_BYTES = 1 << 30
"""Maximum number of bytes that one call of the system reads."""


class FileBytes:
    """The bytes of a file, or of a part of a file. Only accessed slices are read.

    The file is not mapped into memory, because other programs may truncate it while it is read, such as a frame file of
    a live clip. The system ends a process that then accesses mapped bytes (SIGBUS).

    Args:
        path: The file; it stays open as long as this object lives.

    Raises:
        DatasetError: If it is not an ordinary file.
        OSError: If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        with open_regular(path, DatasetError) as file:
            handle = os.dup(file.fileno())
        weakref.finalize(self, os.close, handle)
        self._path, self._start, self._size = path, 0, os.fstat(handle).st_size
        self._file = io.FileIO(handle, closefd=False)
        self._whole: FileBytes | None = None

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> memoryview:
        """Reads a slice.

        The bytes of a large slice are in a temporary file, so that they may exceed the main memory (`large_empty`).

        Raises:
            DatasetError: If the file was truncated meanwhile.
        """
        start, stop, _ = part.indices(self._size)
        data, num_read = large_empty((max(stop - start, 0),), np.uint8).data, 0
        self._file.seek(self._start + start)
        while num_read < len(data):
            count = self._file.readinto(data[num_read : num_read + _MAX_READ_BYTES])
            if not count:
                raise DatasetError(f"{self._path}: was truncated while it was read")
            num_read += count
        return data

    def part(self, start: int, stop: int) -> "FileBytes":
        """Returns the part from byte `start` to byte `stop` (exclusive), without reading it."""
        start, stop, _ = slice(start, stop).indices(self._size)
        view = copy.copy(self)  # the file stays open as long as one of them lives
        view._start, view._size, view._whole = self._start + start, max(stop - start, 0), self
        return view


def is_in_folder_of(path: Path, other: Path) -> bool:
    """True if a file is in the folder of a scene, or below it, after symbolic links are resolved.

    Args:
        path: File of the scene.
        other: File to which the scene refers; it need not exist.
    """
    # in the cache of the Hugging Face Hub, the files of a scene are links to a folder `blobs`
    resolved = Path(os.path.realpath(other))
    return (
        resolved.is_relative_to(os.path.realpath(path.parent)) or resolved.parent == Path(os.path.realpath(path)).parent
    )


def warn_of_bytes_outside(path: Path, count: int, where: str = "after its end") -> None:
    """Logs a warning if a file has bytes outside of the scene's data, such as an appended second file.

    Args:
        path: The file.
        count: Number of these bytes.
        where: Position of these bytes, for the message.
    """
    if count > 0:
        LOG.warning(
            "%s: %s bytes %s are not read: the file may be damaged, or several files in one", path, f"{count:,}", where
        )
