"""Errors that mean that a resource of the system is used up, in one line that says which and what to do."""

import errno
from collections.abc import Iterator

_ADVICE = {
    errno.EFBIG: "File too large: the size of files is limited here (`ulimit -f`)",
    errno.ENOSPC: "No space left on device: free some, or name an output elsewhere",
    errno.EDQUOT: "Disk quota exceeded: free some space, or name an output elsewhere",
    errno.EMFILE: "Too many open files: their number is limited here (`ulimit -n`)",
    errno.ENFILE: "Too many open files in the whole system",
    errno.ENOMEM: "Cannot allocate memory",
}
"""Texts for error numbers of the system."""
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
"""Words in errors of libraries that have no error number."""


def resource_problem(error: BaseException) -> str | None:
    """Describes an error that comes from a used up resource; None for any other one.

    Args:
        error: The error, with its causes.
    """
    for cause in _chain(error):
        if isinstance(cause, MemoryError):
            text = f"{_MEMORY}: {cause}".rstrip(": ")
            return text + _address_space()
        if isinstance(cause, OSError) and cause.errno in _ADVICE:
            where = "" if cause.filename is None else f"{cause.filename}: "
            return where + _ADVICE[cause.errno]
        if "libllvmlite" in str(cause) and _address_space():
            return _MEMORY + _address_space()
        found = next((text for marker, text in _MARKERS if marker in str(cause).lower()), None)
        if found is not None:
            return found + (_address_space() if _MEMORY in found else "")
    return None


def _address_space() -> str:
    """The limit of the address space, if there is one; libraries alone take more than a gigabyte of it."""
    try:
        import resource
    except ImportError:  # not on Windows
        return ""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return ""
    return f" (its address space is limited to {limit / 1e9:.1f} GB, `ulimit -v`: raise that)"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error, what it was raised from, and so on."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__
