"""Memory-mapped files."""

import mmap
import os
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import open_regular


def mapped_file(path: Path) -> memoryview:
    """Maps a file into memory, so that only accessed parts are read.

    Raises:
        DatasetError: If the file is not an ordinary file.
        OSError: If the file cannot be read.
    """
    with open_regular(path, DatasetError) as file:
        if not os.fstat(file.fileno()).st_size:  # an empty file cannot be mapped
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
