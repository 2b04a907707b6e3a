"""Large arrays that need no memory: their pages are those of a temporary file, written out when memory is short."""

import mmap
import os
import tempfile
from typing import Any

import numpy as np

LARGE_BYTES = 32 << 20


def large_empty(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array whose content is undefined, as `np.empty` makes it.

    From `LARGE_BYTES` on it lies in a temporary file without a name, which is gone with the array; in memory where
    there is no room on disk (`TMPDIR` says which disk).

    Args:
        shape: Of the array.
        dtype: Of its elements.
    """
    count, kind = int(np.prod(shape, dtype=np.int64)), np.dtype(dtype)
    size = count * kind.itemsize
    if size < LARGE_BYTES:
        return np.empty(shape, kind)
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)  # a full disk is told now, not by a signal
            else:
                file.truncate(size)
            pages = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, kind)
    return np.frombuffer(pages, dtype=kind, count=count).reshape(shape)
