"""Files that are read without being loaded."""

import mmap
import os
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.capped import open_regular


def mapped_file(path: Path) -> memoryview:
    """Maps a file into memory: of a file of gigabytes only what is looked at is read.

    Raises:
        DatasetError: If it is no ordinary file.
        OSError: If it cannot be read.
    """
    with open_regular(path, DatasetError) as file:
        if not os.fstat(file.fileno()).st_size:  # nothing cannot be mapped
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
