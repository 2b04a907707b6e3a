"""One-line messages for errors of the operating system (exhausted resources, missing permissions), with advice."""

import errno
import os
import resource
from collections.abc import Iterator

from splatwire.errors import ACCESS_ADVICE

_ADVICE = {
    errno.EFBIG: "File too large: the size of files is limited here (`ulimit -f`)",
    errno.ENOSPC: "No space left on device: free some, or name an output elsewhere",
    errno.EDQUOT: "Disk quota exceeded: free some space, or name an output elsewhere",
    errno.EMFILE: "Too many open files: their number is limited here (`ulimit -n`)",
    errno.ENFILE: "Too many open files in the whole system",
    errno.ENOMEM: "Cannot allocate memory",
}
"""Message for each error number (errno)."""
_MIN_ADDRESS_SPACE = 1_000_000_000
_UNUSABLE_ADDRESS_SPACE = 500_000_000
"""Address space below which libraries abort the process or wait without end, bytes."""
_MEMORY = "there is not enough memory here"
_MARKERS = (
    ("failed to map segment", _MEMORY),
    ("cannot allocate memory", _MEMORY),
    ("can't allocate memory", _MEMORY),
    ("std::bad_alloc", _MEMORY),
    ("can't start new thread", f"{_MEMORY} for another thread, or threads are limited (`ulimit -u`)"),
    ("os error 27", _ADVICE[errno.EFBIG]),
    ("os error 28", _ADVICE[errno.ENOSPC]),
    ("file write failed", "a file could not be written: the device may be full, or its size limited (`ulimit -f`)"),
)
"""Texts of library errors that have no error number, each with the message for it."""


def resource_problem(error: BaseException) -> str | None:
    """Returns an error message if an error was caused by an exhausted resource (memory, disk, files), else None.

    Args:
        error: The exception, with its chain of causes.
    """
    for cause in _exception_chain(error):
        if isinstance(cause, MemoryError):
            text = f"{_MEMORY}: {cause}".rstrip(": ")
            return text + _address_space_hint()
        if isinstance(cause, OSError) and cause.errno in _ADVICE:
            is_about_file = cause.filename is not None and cause.errno not in (errno.EMFILE, errno.ENFILE)
            where = f"{cause.filename}: " if is_about_file else ""
            return where + _ADVICE[cause.errno]
        if "libllvmlite" in str(cause) and _address_space_hint():
            return _MEMORY + _address_space_hint()
        description = next((text for marker, text in _MARKERS if marker in str(cause).lower()), None)
        if description is not None:
            return description + (_address_space_hint() if _MEMORY in description else "")
    return None


def file_problem(error: OSError) -> str:
    """Returns an error message with the path first, without the error number, and with advice if access was denied."""
    if error.filename is None or not error.strerror:
        return str(error)
    where = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
    return f"{where}: {error.strerror}{ACCESS_ADVICE if isinstance(error, PermissionError) else ''}"


def address_space_warning() -> str:
    """Returns a warning if the limit of the address space may be too low for libraries; otherwise an empty text.

    Raises:
        MemoryError: If the limit is so low that libraries would certainly fail.
    """
    # Such a process may be aborted inside a library, before Python can print an error.
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY or limit >= _MIN_ADDRESS_SPACE:
        return ""
    if limit < _UNUSABLE_ADDRESS_SPACE:
        raise MemoryError(f"libraries need up to {_MIN_ADDRESS_SPACE / 1e9:.0f} GB of address space")
    return (
        f"the address space is limited to {limit / 1e9:.1f} GB (`ulimit -v`), libraries need up to "
        f"{_MIN_ADDRESS_SPACE / 1e9:.0f} GB: without it, they may end this program"
    )


def _address_space_hint() -> str:
    """Returns a sentence for out-of-memory errors with the limit of the address space; empty if unlimited."""
    # The libraries alone need over 1 GB of address space, so that a low limit is a likely cause.
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return ""
    return f" (its address space is limited to {limit / 1e9:.1f} GB, `ulimit -v`: raise that)"


def _exception_chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yields an exception and all exceptions that caused it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__
