"""Large arrays backed by an unlinked temporary file (mmap), so that they may exceed the main memory."""

import mmap
import os
import tempfile
from typing import Any

import numpy as np

LARGE_BYTES = 32 << 20


def large_empty(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Allocates an array with undefined content; large arrays may exceed the main memory.

    An array of at least `LARGE_BYTES` is backed by a temporary file in `TMPDIR`.

    Args:
        shape: Shape of the array.
        dtype: Type of its elements.
    """
    count, kind = int(np.prod(shape, dtype=np.int64)), np.dtype(dtype)
    size = count * kind.itemsize
    if size < LARGE_BYTES:
        return np.empty(shape, kind)
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)  # reports a full disk here instead of as a later SIGBUS
            else:
                file.truncate(size)
            pages = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, kind)
    return np.frombuffer(pages, dtype=kind, count=count).reshape(shape)
