"""One compilation per kernel, even if several test processes need the kernel at once: the others wait and load it.

Without this, each process compiles the kernels of the codecs, which takes a minute.
"""

import fcntl
import os
from pathlib import Path
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

_compile = Dispatcher.compile
_held: set[Path] = set()
"""Locks of this process; a kernel is compiled within the compilation of the kernels that call it."""


def _compile_once(self: Any, sig: Any) -> Any:
    """Replaces numba's `Dispatcher.compile`: waits while another process compiles the same kernel for the cache."""
    folder = getattr(self._cache, "cache_path", None)  # None for functions without a cache
    lock = Path(folder or "", f"{self.py_func.__module__}.{self.py_func.__qualname__}.lock")
    if folder is None or lock in _held:
        return _compile(self, sig)
    with global_compiler_lock:  # first, as numba takes it: threads would wait for each other otherwise
        os.makedirs(folder, exist_ok=True)
        with lock.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            _held.add(lock)
            try:
                return _compile(self, sig)
            finally:
                _held.discard(lock)
                fcntl.flock(file, fcntl.LOCK_UN)  # explicitly, because child processes keep the file open


def install() -> None:
    """Makes all compilations of this process wait for those of other processes."""
    Dispatcher.compile = _compile_once
