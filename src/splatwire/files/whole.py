"""Files and folders that are there as a whole or not at all: the one way in which anything is written.

A writer works in a hidden folder beside its target, `.splatwire-<id>.part`, and at the end moves the result to its
name. An error removes the hidden folder. A killed writer cannot; but it held a lock on the folder, which the kernel
gives free, so the next writer beside it sees that nobody works there any more and removes it.
"""

import errno
import functools
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splatwire.errors import InvalidValueError

try:
    import fcntl
except ImportError:  # Windows: writing is whole there, too, but what a killed writer left stays
    fcntl = None  # type: ignore[assignment]

_START, _END = ".splatwire-", ".part"
_NEW, _OLD = "new", "old"
_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def written_whole(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Gives a path to write a file or a folder to, of the target's name; at the end it becomes the target.

    A reader sees the old file or the new one. A folder that replaces a folder is missing for a moment between two
    renames; a writer that is killed right there has its old folder put back by the next writer.

    Args:
        target: What to write; folders above it are made. Behind a symbolic link the file that it names is replaced.

    Raises:
        InvalidValueError: If the target is a device or the like.
        OSError: If the disk refuses; then nothing is changed. The error names the target.
    """
    goal = Path(target).resolve()
    if goal.exists() and not goal.is_dir() and not goal.is_file():
        raise InvalidValueError(f"{target} is no ordinary file and would be replaced by one: name another")
    goal.parent.mkdir(parents=True, exist_ok=True)
    _tidy_once(goal.parent)
    try:
        with _workspace(goal.parent) as space:
            (space / _NEW).mkdir()
            new = space / _NEW / goal.name
            yield new
            _take_name(new, goal, space / _OLD)
    except OSError as error:
        hidden = _START in str(error.filename or "")
        if hidden or error.errno in _FULL:
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise


def write_whole(target: str | os.PathLike[str], data: bytes) -> Path:
    """Writes a file as `written_whole` does; returns its path.

    Raises:
        InvalidValueError: If the target is a device or the like.
        OSError: If the disk refuses; then nothing is changed.
    """
    with written_whole(target) as unfinished:
        unfinished.write_bytes(data)
    return Path(target)


def remove_unfinished(folder: Path) -> None:
    """Removes what killed writers left in a folder, and puts back what they had moved out of their way.

    Nothing happens to what a living writer, of this or another process, works in.
    """
    if fcntl is None:
        return
    with suppress(OSError):
        for space in [Path(entry.path) for entry in os.scandir(folder) if _is_ours(entry.name)]:
            with suppress(OSError):
                _remove_dead(space)


def _is_ours(name: str) -> bool:
    return name.startswith(_START) and name.endswith(_END)


@functools.lru_cache(maxsize=1024)
def _tidy_once(folder: Path) -> None:
    """Once per process and folder: a folder of many thousand files is not listed for each of them."""
    remove_unfinished(folder)


def _remove_dead(space: Path) -> None:
    handle = os.open(space, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        if not _lock(handle):
            return
        for old in (space / _OLD).iterdir() if (space / _OLD).is_dir() else ():
            if not (space.parent / old.name).exists():
                old.rename(space.parent / old.name)
        shutil.rmtree(space, ignore_errors=True)
    finally:
        os.close(handle)


@contextmanager
def _workspace(folder: Path) -> Iterator[Path]:
    """A new hidden folder that is locked for as long as it is used, and then removed."""
    while True:
        space = folder / f"{_START}{uuid.uuid4().hex[:12]}{_END}"
        space.mkdir()
        if fcntl is None:
            handle = None
            break
        # Another process may be quicker and take it for a dead writer's: then it is gone, locked or without a name.
        with suppress(FileNotFoundError):
            handle = os.open(space, os.O_RDONLY | os.O_DIRECTORY)
            if _lock(handle) is not False and os.fstat(handle).st_nlink:
                break
            os.close(handle)
    try:
        yield space
    finally:
        shutil.rmtree(space, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def _lock(handle: int) -> bool | None:
    """Whether the lock was free and is now held; None where the file system has no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _take_name(new: Path, goal: Path, aside: Path) -> None:
    if not new.is_dir():
        with new.open("rb") as file:
            os.fsync(file.fileno())  # or the name could outlive the content when the power fails
        os.replace(new, goal)
        return
    if not goal.exists():
        new.rename(goal)
        return
    aside.mkdir()
    goal.rename(aside / goal.name)  # out of the way as a whole: no old file stays among the new ones
    try:
        new.rename(goal)
    except OSError:
        (aside / goal.name).rename(goal)
        raise
