"""Compilation of numba kernels, with a cache of machine code that works in any installation.

Each compilation is logged, and each wait for another process that compiles a kernel.
"""

import functools
import hashlib
import logging
import os
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from splatwire.ops._cache_file import CacheFile, log_unwritable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOG = logging.getLogger(__name__)

_F = TypeVar("_F", bound=Callable[..., Any])
_LOCK = threading.Lock()
_TURN_S = 300.0
"""Longest wait for another process that compiles the same kernel, seconds: it may be suspended."""
_NOTICE_S = 1.0
"""Longest wait that is not logged, seconds: the other process may only load the kernel."""
_POLL_S = 0.05
_IN_VAIN = threading.Event()
"""Set after a wait of `_TURN_S`, to prevent later waits: a suspended process may have locked many kernels."""
_HELD: set[Path] = set()
"""Lock files that this process holds. There may be several: compiling a kernel also compiles the kernels that it calls.
"""


def _supports_option(option: str) -> bool:
    """True if the installed numba version supports the private compiler option with the name `option`."""
    try:
        from numba.core.registry import cpu_target

        return hasattr(cpu_target.options, option)
    except (ImportError, AttributeError):
        return False


def _skip_scipy_import() -> None:
    """Prevents the slow import of scipy's linear algebra by numba at start."""
    with suppress(ImportError, AttributeError):
        # numba only checks at start if scipy is present; it imports it when a kernel has matrix products
        from numba.np import linalg

        linalg.ensure_blas = lambda: None


_skip_scipy_import()
CAN_BORROW = _supports_option("_nrt")
"""True if reference counting of arrays can be disabled; otherwise kernels are slower with equal results."""


def njit(*, borrows: bool = False, **options: Any) -> Callable[[_F], _F]:
    """`numba.njit` with a cache of machine code that works wherever the package is installed.

    Args:
        borrows: True to compile without reference counting. The function must only read and write its array arguments;
            it must neither allocate nor return arrays.
        **options: Options of `numba.njit`; `cache` is always on.
    """
    if borrows and CAN_BORROW:
        # the atomic operations of reference counting dominate the time of small functions
        options["_nrt"] = False

    def decorate(function: _F) -> _F:
        try:
            return _with_shared_cache(numba.njit(cache=True, **options)(function))
        except RuntimeError:  # numba found no writable cache folder
            folder = private_folder()
        if folder is None:
            return numba.njit(**options)(function)
        with _cache_in(folder):
            return _with_shared_cache(numba.njit(cache=True, **options)(function))

    return decorate


def _with_shared_cache(kernel: Any) -> Any:
    """Makes a kernel's cache of machine code safe for use by several processes; returns the kernel.

    Only one of the processes compiles the kernel; the others load the cached code. A change of a source file or of a
    constant invalidates the cached code.
    """
    if not numba.config.DISABLE_JIT:
        cache = kernel._cache
        stamp = (cache._cache_file._source_stamp, _sources_digest(kernel.py_func.__module__))
        cache._cache_file = CacheFile(cache._cache_file, stamp)
        cache.save_overload = _without_folder_errors(cache)
        kernel.compile = _compile_once(kernel)
    return kernel


def _compile_once(kernel: Any) -> Callable[[Any], Any]:
    """Wraps the compilation of a kernel, so that one process compiles the kernel and the others load the cached code.

    Args:
        kernel: The kernel, a dispatcher of numba.

    Returns:
        Function that compiles the kernel for a signature.
    """
    make = kernel.compile
    file = Path(kernel._cache.cache_path, f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}.lock")

    def compile_once(signature: Any) -> Any:
        with global_compiler_lock:  # first, as numba takes it: threads would wait for each other otherwise
            if file in _HELD:  # a recursive kernel, or one of equal name
                return make(signature)
            with _file_lock(file, kernel.py_func.__qualname__):
                _HELD.add(file)
                try:
                    return make(signature)
                finally:
                    _HELD.discard(file)

    return compile_once


@contextmanager
def _file_lock(path: Path, kernel: str) -> Iterator[None]:
    """Context manager with a file lock, so that only one process compiles a kernel.

    The context begins without the lock in three cases: the file cannot be opened, the system has no locks, or another
    process holds the lock for too long (see `_wait_for`). Two processes may then compile and store the same kernel,
    which `CacheFile` permits.

    Args:
        path: The lock file; created if it is absent.
        kernel: Name of the kernel, for the log.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600) if fcntl else None
    except OSError:
        handle = None
    try:
        if handle is not None:
            _wait_for(handle, kernel)
        yield
    finally:
        if handle is not None:
            with suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_UN)  # explicitly, because child processes keep the file open
            os.close(handle)


def _wait_for(handle: int, kernel: str) -> None:
    """Locks an open file; returns without the lock if another process holds it for longer than `_TURN_S` seconds.

    After such a timeout, later calls in this process do not wait: they try to lock the file only once. A wait longer
    than `_NOTICE_S` seconds is logged. From then on until the wait ends, `is_compiling` returns True.

    Args:
        handle: File descriptor of the lock file.
        kernel: Name of the kernel that is to be compiled, for the log.
    """
    waits = not _IN_VAIN.is_set()
    if _lock_within(_NOTICE_S if waits else 0.0, handle) or not waits:
        return
    LOG.info("waiting for another process that compiles %s", kernel, extra={"waits": True})
    with _COMPILATIONS.counted():
        if not _lock_within(_TURN_S - _NOTICE_S, handle):
            _IN_VAIN.set()


def _lock_within(duration_s: float, handle: int) -> bool:
    """Tries to lock an open file for a limited time.

    Args:
        duration_s: Time during which attempts are repeated, seconds. With 0, there is a single attempt.
        handle: File descriptor of the file.

    Returns:
        True if the file is locked, or if its file system has no locks. False if another process still holds the lock.
    """
    end = time.monotonic() + duration_s
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= end:
                return False
            time.sleep(_POLL_S)
        except OSError:  # a file system without locks
            return True
        else:
            return True


def _without_folder_errors(cache: Any) -> Callable[[Any, Any], None]:
    """Wraps numba's function that stores machine code: errors of the file system are logged instead of raised.

    Args:
        cache: Cache of a kernel.
    """
    save = cache.save_overload

    def save_overload(signature: Any, compiled: Any) -> None:
        try:
            save(signature, compiled)
        except OSError as error:
            log_unwritable(Path(cache.cache_path), error)

    return save_overload


@functools.cache
def _sources_digest(module: str) -> str:
    """Returns a hash of all source files and constants that the kernels of a module are compiled from."""
    modules: dict[str, list[str]] = {}
    _collect_constants(module, modules)
    digest = hashlib.sha256()
    for name in sorted(modules):
        digest.update("\n".join((name, *modules[name])).encode())
        if name != module:  # numba itself stamps the kernel's own file
            status = Path(sys.modules[name].__file__ or os.devnull).stat()
            digest.update(f"{status.st_mtime_ns} {status.st_size}".encode())
    return digest.hexdigest()


def _collect_constants(module: str, constants_by_module: dict[str, list[str]]) -> None:
    """Collects the constants that may be compiled into the kernels of a module.

    These are the constants of the module itself, and of the modules of this package that it imports.

    Cached machine code is valid only as long as these constants are the same.

    Args:
        module: Full name of the module.
        constants_by_module: Output: the constants as texts, by full name of the module.
    """
    constants: list[str] = []
    constants_by_module[module] = constants
    names = vars(sys.modules[module]) if module in sys.modules else {}
    for name, value in sorted(names.items()):
        origin = getattr(value, "__module__", None)
        if isinstance(value, np.ndarray):
            constants.append(f"{name} {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
        elif isinstance(value, int | float | tuple) and not name.startswith("__"):
            constants.append(f"{name} {value!r}")
        elif (
            isinstance(origin, str)
            and origin not in constants_by_module
            and origin.partition(".")[0] == module.partition(".")[0]
        ):
            _collect_constants(origin, constants_by_module)


@functools.cache
def private_folder() -> Path | None:
    """Returns a temporary folder for compiled code, to which only this user can write.

    All processes of the user get the same folder.

    Returns:
        The folder, or None if no safe one is available.
    """
    if hasattr(os, "getuid"):
        with suppress(OSError):  # no temporary folder, a full or read-only one, or a file of that name
            parent = Path(tempfile.gettempdir())
            folder = parent / f"splatwire-kernels-{os.getuid()}"
            folder.mkdir(mode=0o700, exist_ok=True)
            # numba unpickles and executes the content of its cache
            if _is_safe_parent(parent) and _only_ours(folder):
                return folder
    LOG.warning("no safe place to keep compiled kernels in, so each process compiles them: set NUMBA_CACHE_DIR")
    return None


def _only_ours(folder: Path) -> bool:
    status = folder.lstat()
    mode = status.st_mode
    ours = stat.S_ISDIR(mode) and status.st_uid == os.getuid() and not mode & 0o077
    return ours and os.access(folder, os.W_OK | os.X_OK)


def _is_safe_parent(parent: Path) -> bool:
    """True if only the current user and root can rename, replace or delete files in a folder."""
    status = parent.stat()
    shared = status.st_mode & 0o022 and not status.st_mode & stat.S_ISVTX
    return status.st_uid in (0, os.getuid()) and not shared


@contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """Sets numba's cache folder for kernels created within the context."""
    with _LOCK:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


class _Compilations(event.Listener):
    """Listener that logs compilations of kernels, and counts the compilations that are running.

    Attributes:
        depth: Number of running compilations in the current thread; one compilation can start another.
        num_running: Sum of two numbers: compilations that are running in this process, and threads of this process that
            wait for another process to compile a kernel.
    """

    def __init__(self) -> None:
        self.depth = threading.local()
        self.num_running = 0

    def on_start(self, event: Any) -> None:
        depth = getattr(self.depth, "value", 0)
        function = event.data["dispatcher"].py_func
        if depth == 0 and function.__module__.startswith("splatwire."):
            LOG.info("compiling %s", function.__qualname__)
        self.depth.value = depth + 1
        self._count(1)

    def on_end(self, event: Any) -> None:
        self.depth.value -= 1
        self._count(-1)

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Context manager that increases `num_running` by 1 while a thread waits for another process."""
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)

    def _count(self, change: int) -> None:
        with _LOCK:
            self.num_running += change


_COMPILATIONS = _Compilations()
event.register("numba:compile", _COMPILATIONS)


def is_compiling() -> bool:
    """True if a thread of this process compiles a kernel, or waits for the compilation by another process."""
    return _COMPILATIONS.num_running > 0
