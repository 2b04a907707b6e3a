"""Memory-mapped files, the folder of a scene, and warnings about bytes that no reader uses."""

import logging
import mmap
import os
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import open_regular

LOG = logging.getLogger(__name__)

MAPPED_BYTES = 32 << 20
"""Size from which a file is mapped instead of read, bytes. If a program truncates a mapped file meanwhile, such as a
frame of a live clip that is written again, the system ends this process (SIGBUS)."""


def mapped_file(path: Path) -> memoryview:
    """Reads a small file, or maps a large one into memory, so that only accessed parts are read.

    Raises:
        DatasetError: If the file is not an ordinary file.
        OSError: If the file cannot be read.
    """
    with open_regular(path, DatasetError) as file:
        size = os.fstat(file.fileno()).st_size
        if size < MAPPED_BYTES:
            return memoryview(file.read(size))
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def is_in_folder_of(path: Path, other: Path) -> bool:
    """True if a file is in the folder of a scene, or below it, after symbolic links are resolved.

    Args:
        path: The scene, a file.
        other: File that the scene names; it need not exist.
    """
    # in the cache of the Hugging Face Hub, the files of a scene are links to a folder `blobs`
    found = Path(os.path.realpath(other))
    return found.is_relative_to(os.path.realpath(path.parent)) or found.parent == Path(os.path.realpath(path)).parent


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
