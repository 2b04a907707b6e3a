"""Kernels that numba compiles: where their machine code is kept, and who is told that compiling takes a while.

Compiling is told as records of the logger of this module: one of level INFO at the start of each kernel that is called
from Python, with what it calls. A kernel that comes out of the cache is silent.
"""

import functools
import hashlib
import logging
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import event

LOG = logging.getLogger(__name__)

_F = TypeVar("_F", bound=Callable[..., Any])
_LOCK = threading.Lock()


def _knows(option: str) -> bool:
    """Whether this numba has a private option: it may rename those in any release."""
    try:
        from numba.core.registry import cpu_target

        return hasattr(cpu_target.options, option)
    except (ImportError, AttributeError):
        return False


def _spare_scipy() -> None:
    """Keeps numba, as it begins, from loading scipy's linear algebra only to see whether it is there.

    That takes as long as loading numba itself. A kernel that multiplied matrices would load it when it is compiled.
    """
    with suppress(ImportError, AttributeError):
        from numba.np import linalg

        linalg.ensure_blas = lambda: None


_spare_scipy()
CAN_BORROW = _knows("_nrt")
"""Whether counting who holds an array can be left out; where it cannot, kernels are slower and say the same."""


def njit(*, borrows: bool = False, **options: Any) -> Callable[[_F], _F]:
    """`numba.njit` with a cache that has a place wherever the package is installed.

    numba keeps machine code in the folder that `NUMBA_CACHE_DIR` names, beside the source, or in the user's home. Where
    it may write to none of these (a container with a read-only root and no home), numba itself raises an error; here a
    temporary folder of the user takes its place, and where there is none either, nothing is kept.

    numba takes machine code for old only where the kernel's own file has changed; here also where one has that its
    callees or constants come from.

    Args:
        borrows: Whether a function only uses the arrays that it is given, makes none, and returns none that it made.
            Then nobody counts who holds them; each such count is an atomic operation, and small functions that pass
            arrays on to each other spend most of their time on it.
        options: Those of `numba.njit`; `cache` is always on.
    """
    if borrows and CAN_BORROW:
        options["_nrt"] = False

    def decorate(function: _F) -> _F:
        try:
            return _stamped(numba.njit(cache=True, **options)(function))
        except RuntimeError:  # no place for a cache
            folder = private_folder()
        if folder is None:
            return numba.njit(**options)(function)
        with _cache_in(folder):
            return _stamped(numba.njit(cache=True, **options)(function))

    return decorate


def _stamped(kernel: Any) -> Any:
    """Has the cache of a kernel count as old when what it was made of has changed, in whatever file that stands."""
    if not numba.config.DISABLE_JIT:
        file = kernel._cache._cache_file
        file._source_stamp = (file._source_stamp, _made_of(kernel.py_func.__module__))
        file._load_index = _forgiving(file._load_index)
    return kernel


def _forgiving(load: Callable[[], dict[Any, str]]) -> Callable[[], dict[Any, str]]:
    """Has an index that cannot be read count as empty: one of another release names types that are gone by now."""

    def index() -> dict[Any, str]:
        try:
            return load()
        except Exception:  # pickle raises whatever it meets
            return {}

    return index


@functools.cache
def _made_of(module: str) -> str:
    """Digests what kernels of a module are made of, as imported before its first one: files of callees, constants."""
    modules: dict[str, list[str]] = {}
    _follow(module, modules)
    digest = hashlib.sha256()
    for name in sorted(modules):
        digest.update("\n".join((name, *modules[name])).encode())
        if name != module:  # its own file has a stamp of numba's, which a module without a file does not need
            status = Path(sys.modules[name].__file__ or os.devnull).stat()
            digest.update(f"{status.st_mtime_ns} {status.st_size}".encode())
    return digest.hexdigest()


def _follow(module: str, found: dict[str, list[str]]) -> None:
    """Notes the constants of a module, and those of all modules of its package that it has functions or types of."""
    constants: list[str] = []
    found[module] = constants
    names = vars(sys.modules[module]) if module in sys.modules else {}
    for name, value in sorted(names.items()):
        origin = getattr(value, "__module__", None)
        if isinstance(value, np.ndarray):
            constants.append(f"{name} {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
        elif isinstance(value, int | float | tuple) and not name.startswith("__"):
            constants.append(f"{name} {value!r}")
        elif isinstance(origin, str) and origin not in found and origin.partition(".")[0] == module.partition(".")[0]:
            _follow(origin, found)


@functools.cache
def private_folder() -> Path | None:
    """A temporary folder that only this user can write to; it is made if need be, and the same in every process.

    numba unpickles what it finds in a cache and runs it, so a folder that another user made, or can put something into
    or in the place of, is not taken.

    Returns:
        The folder, or None where there is none to be trusted.
    """
    if hasattr(os, "getuid"):
        with suppress(OSError):  # no temporary folder, a full or read-only one, or a file of that name
            parent = Path(tempfile.gettempdir())
            folder = parent / f"splatwire-kernels-{os.getuid()}"
            folder.mkdir(mode=0o700, exist_ok=True)
            if _keeps_names(parent) and _only_ours(folder):
                return folder
    LOG.warning("no safe place to keep compiled kernels in, so each process compiles them: set NUMBA_CACHE_DIR")
    return None


def _only_ours(folder: Path) -> bool:
    status = folder.lstat()
    mode = status.st_mode
    ours = stat.S_ISDIR(mode) and status.st_uid == os.getuid() and not mode & 0o077
    return ours and os.access(folder, os.W_OK | os.X_OK)


def _keeps_names(parent: Path) -> bool:
    """Whether nobody but its owner, who is this user or root, can rename what others have put into a folder."""
    status = parent.stat()
    shared = status.st_mode & 0o022 and not status.st_mode & stat.S_ISVTX
    return status.st_uid in (0, os.getuid()) and not shared


@contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """Has numba choose a folder for the kernels that are made meanwhile, and for no others."""
    with _LOCK:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


class _Compilations(event.Listener):
    """Logs each kernel that is compiled, with its callees as part of it."""

    def __init__(self) -> None:
        self.depth = threading.local()

    def on_start(self, event: Any) -> None:
        depth = getattr(self.depth, "value", 0)
        function = event.data["dispatcher"].py_func
        if depth == 0 and function.__module__.startswith("splatwire."):
            LOG.info("compiling %s", function.__qualname__)
        self.depth.value = depth + 1

    def on_end(self, event: Any) -> None:
        self.depth.value -= 1


event.register("numba:compile", _Compilations())
