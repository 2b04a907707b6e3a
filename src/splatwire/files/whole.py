"""Files and folders that are there as a whole or not at all: the one way in which anything is written.

A writer works in a hidden folder beside its target, `.splatwire-<id>.part`, and at the end moves the result to its
name. An error removes the hidden folder. A killed writer cannot; but it held a lock on the folder, which the kernel
gives free, so the next writer beside it sees that nobody works there any more and removes it.
"""

import errno
import functools
import os
import re
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
_WORKSPACE = re.compile(r"\.splatwire-[0-9a-f]{12}\.part")
"""Names of hidden folders, as `_workspace` makes them."""
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
        InvalidValueError: If the target is a device or the like, or a link that leads to itself.
        OSError: If the disk refuses; then nothing is changed. The error names the target.
    """
    try:
        goal = Path(target).resolve()
    except RuntimeError as error:  # Python 3.11 and 3.12; later ones leave it to the next line
        raise InvalidValueError(f"{target} is a symbolic link that leads to itself") from error
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
        InvalidValueError: If the target is a device or the like, or a link that leads to itself.
        OSError: If the disk refuses; then nothing is changed.
    """
    with written_whole(target) as unfinished:
        unfinished.write_bytes(data)
    return Path(target)


def remove_unfinished(folder: Path) -> None:
    """Removes what killed writers left in a folder, and restores folders that they had moved aside.

    Nothing happens to the workspace of a living writer, of this or another process. A folder may come from anywhere,
    for instance from a version control system, with names made up to look like workspaces. Only folders of this user
    count as such. No symbolic link in them is followed or restored, even one that appears meanwhile.
    """
    if fcntl is None:
        return
    with suppress(OSError), _opened_folder(os.fspath(folder), None, follow=True) as parent:
        for name in [entry.name for entry in os.scandir(parent) if _WORKSPACE.fullmatch(entry.name)]:
            with suppress(OSError), _opened_folder(name, parent) as space:
                if _lock(space):
                    _restore(space, parent)
                    shutil.rmtree(name, ignore_errors=True, dir_fd=parent)


@functools.lru_cache(maxsize=1024)
def _tidy_once(folder: Path) -> None:
    """Once per process and folder: a folder of many thousand files is not listed for each of them."""
    remove_unfinished(folder)


@contextmanager
def _opened_folder(name: str, parent: int | None, *, follow: bool = False) -> Iterator[int]:
    """Opens a folder of this user.

    Args:
        name: Name of the folder.
        parent: Open folder that contains it; None for the working directory.
        follow: True to follow a link and to accept the folder of another user.

    Raises:
        OSError: If it is no folder, a link, or another user's.
    """
    handle = os.open(name, os.O_RDONLY | os.O_DIRECTORY | (0 if follow else os.O_NOFOLLOW), dir_fd=parent)
    try:
        if not follow and os.fstat(handle).st_uid != os.geteuid():
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), name)
        yield handle
    finally:
        os.close(handle)


def _restore(space: int, parent: int) -> None:
    """Moves folders that a killed writer had moved aside back to their names, where these are free."""
    with suppress(OSError), _opened_folder(_OLD, space) as aside:
        for name in os.listdir(aside):
            with suppress(OSError), _opened_folder(name, aside):
                if not _exists(name, parent):
                    os.rename(name, name, src_dir_fd=aside, dst_dir_fd=parent)


def _exists(name: str, parent: int) -> bool:
    """Returns True if there is a file, folder or link of that name."""
    try:
        os.stat(name, dir_fd=parent, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


@contextmanager
def _workspace(folder: Path) -> Iterator[Path]:
    """A new hidden folder that is locked for as long as it is used, and then removed."""
    while True:
        space = folder / f"{_START}{uuid.uuid4().hex[:12]}{_END}"
        space.mkdir(mode=0o700)
        if fcntl is None:
            handle = None
            break
        # Another process may be quicker and take it for a dead writer's: then it is gone, locked or without a name.
        with suppress(FileNotFoundError):
            handle = os.open(space, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
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
