"""Atomic writing of files and folders; all output of the package uses it.

Output is written to a hidden folder next to the target, and finally renamed. If a writer is killed, the next writer in
the same folder cleans up.
"""

import errno
import functools
import os
import re
import shutil
import stat
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splatwire.errors import InvalidValueError
from splatwire.files.names import path_of

try:
    import fcntl
except ImportError:  # Windows: writing is atomic too, but leftovers of killed writers stay
    fcntl = None  # type: ignore[assignment]

_START, _END = ".splatwire-", ".part"
_WORKSPACE = re.compile(r"\.splatwire-[0-9a-f]{12}\.part")
"""Name pattern of hidden folders created by `_workspace`."""
_NEW, _OLD, _MOVING = "new", "old", "moving"
"""Folders of a workspace: unfinished output, replaced output, and complete output while it is moved into a folder."""
_UNFINISHED = re.compile(rf"{_WORKSPACE.pattern}[/\\](?:{_NEW}|{_MOVING})[/\\]")
_NO_OUTPUT = (errno.ENOTDIR, errno.ELOOP, errno.EPERM)
"""Errors of opening an unmoved output that is a file, a link or another user's: no writer leaves such."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_output(target: str | os.PathLike[str], *, parents: bool = False) -> Iterator[Path]:
    """Yields a temporary path for a file or folder, which replaces the target atomically on success.

    A folder cannot be replaced in a single step. The old folder is therefore renamed first, and the path does not
    exist for a moment. An empty folder is replaced in a single step, by a folder with the same owner and permissions.
    An empty folder is kept, and the new content is moved into it, if the folder is the working directory or a mounted
    disk, if its parent folder is read-only, or if new files in it inherit its group or access rules. If the program
    is killed during this move, `is_unfinished` returns True for the folder, and the next writer in the folder
    finishes the move.

    Args:
        target: Path of the output. For a symbolic link, the file it refers to is replaced.
        parents: True to create missing parent folders; False to raise an error.

    Raises:
        InvalidValueError: If the target is not a valid path, is a special file such as a device, or is a link to
            itself; or if its parent folder does not exist.
        OSError: If the system call fails; nothing is changed then.
    """
    with _atomic_output(target, parents=parents) as new:
        yield new


@contextmanager
def _atomic_output(
    target: str | os.PathLike[str], *, parents: bool, merge: Callable[[Path, Path], None] | None = None
) -> Iterator[Path]:
    """Context manager for `atomic_output`.

    Args:
        target: Path of the output.
        parents: True to create missing parent folders.
        merge: Function that moves the files of the new folder into a folder that another program has made or filled
            in the meantime; None to replace that folder.
    """
    goal = _resolved_target(path_of(target))
    if parents:
        goal.parent.mkdir(parents=True, exist_ok=True)
    check_parent(goal)
    if goal.is_dir():  # a killed writer may have left its workspace in a folder that is otherwise empty
        _tidy_once(goal)
    is_empty = goal.is_dir() and not any(goal.iterdir())
    keeps = is_empty and _must_be_kept(goal)
    parent = goal if keeps else goal.parent
    _tidy_once(parent)
    try:
        with _workspace(parent) as space:
            (space / _NEW).mkdir()
            new = space / _NEW / goal.name
            yield new
            if is_empty and not new.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
            is_filled = goal.is_dir() and any(entry != space for entry in goal.iterdir())
            if merge is not None and goal.is_dir() and (is_filled or not is_empty):
                merge(new, goal)
            elif keeps:
                _move_into(space, goal)
            elif is_empty:
                _replace_empty(new, goal)
            else:
                _take_name(new, goal, space / _OLD)
    except OSError as error:
        hidden = _START in str(error.filename or "")
        if hidden or error.errno in _FULL:
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise


@contextmanager
def atomic_files(folder: str | os.PathLike[str], last: str) -> Iterator[Path]:
    """Yields a temporary folder; on success, its files replace those of the same names in a folder.

    Other files of the folder are kept. The file `last` marks the folder as complete. An older file `last` is removed
    before the first file is replaced, and the new one is moved into the folder after all other files. A new
    folder, or an empty one that may be replaced, gets all files at once (see `atomic_output`).

    Args:
        folder: The folder.
        last: Name of the file that is moved last.

    Raises:
        InvalidValueError: As for `atomic_output`.
        OSError: If the system call fails.
    """
    goal = _resolved_target(path_of(folder))
    if goal.is_dir():
        _tidy_once(goal)
    if not goal.is_dir() or not any(goal.iterdir()):
        with _atomic_output(folder, parents=True, merge=functools.partial(_replace_files, last=last)) as new:
            new.mkdir()
            yield new
        return
    try:
        with _workspace(goal) as space:
            new = space / _NEW / goal.name
            new.mkdir(parents=True)
            yield new
            _replace_files(new, goal, last)
    except OSError as error:
        if _START in str(error.filename or "") or error.errno in _FULL:
            raise OSError(error.errno, error.strerror, str(folder)) from error
        raise


def _replace_files(new: Path, target: Path, last: str) -> None:
    """Moves the files of a folder into another one, where they replace files of the same names.

    Args:
        new: Folder of the new files.
        target: The other folder.
        last: Name of the file that is moved last. An older file of that name is removed first.
    """
    names = sorted((entry.name for entry in new.iterdir()), key=lambda name: (name == last, name))
    for name in names:
        _flush(new / name)
    (target / last).unlink(missing_ok=True)
    for name in names:
        os.replace(new / name, target / name)


def is_unfinished(folder: Path) -> bool:
    """True while a program moves its output into a folder, or if it was killed meanwhile (see `atomic_output`).

    Raises:
        OSError: If the folder cannot be listed.
    """
    # `os.path.isdir` is False for the closed workspaces of other users, where `Path.is_dir` raises an error
    return any(_WORKSPACE.fullmatch(entry.name) and os.path.isdir(entry / _MOVING) for entry in folder.iterdir())


def atomic_write(target: str | os.PathLike[str], data: bytes, *, parents: bool = False) -> Path:
    """Writes a file atomically and returns the path of the file.

    Raises:
        InvalidValueError: As for `atomic_output`.
        OSError: If the system call fails; nothing is changed then.
    """
    with atomic_output(target, parents=parents) as unfinished:
        unfinished.write_bytes(data)
    return Path(target)


def check_parent(path: Path) -> None:
    """Checks that the parent folder of an output exists.

    Raises:
        InvalidValueError: If the parent does not exist, or is not a folder.
    """
    parent = path.absolute().parent
    existing = next(folder for folder in (parent, *parent.parents) if folder.exists())
    if not existing.is_dir():
        raise InvalidValueError(f"{existing}: not a folder, so nothing can be written into it")
    if existing != parent:
        raise InvalidValueError(f"{parent}: no such folder, so {path.name} cannot be written into it: make it first")


def check_writable(path: Path, *, inside: bool = False) -> None:
    """Checks that an output can be written, before the work starts.

    Args:
        path: Path of the output.
        inside: True if `path` is an existing folder, and the output is files in it.

    Raises:
        InvalidValueError: If the output cannot be written, because its folder does not exist, is read-only or belongs
            to another user.
    """
    into = path if inside else path.parent
    try:
        goal = _resolved_target(path)
        inside = inside and goal.is_dir()
        into = goal if inside else goal.parent
        if not inside:
            check_parent(goal)
        with _workspace(into) as space:
            (space / _NEW).mkdir()  # in `_NEW`, because after a kill only the content of that folder is removed
            (space / _NEW / goal.name).touch()
        replaceable = inside or not goal.exists() or _replaceable(goal)
    except OSError as error:
        raise InvalidValueError(f"{path}: nothing can be written into {into}: {error.strerror}") from error
    if not replaceable:
        raise InvalidValueError(f"{path} is another user's and cannot be replaced: name another")


def _resolved_target(path: Path) -> Path:
    """Follows symbolic links in the path of an output; checks that the output may be replaced."""
    try:
        goal = path.resolve()
    except RuntimeError as error:  # Python 3.11 and 3.12; later ones raise OSError when the path is used
        raise InvalidValueError(f"{path} is a symbolic link that leads to itself") from error
    # `/dev/stdout` refers to a pipe by a link to a name that does not exist
    if path.exists() and not path.is_dir() and not path.is_file():
        raise InvalidValueError(f"{path} is no ordinary file and would be replaced by one: name another")
    return goal


def _replaceable(path: Path) -> bool:
    """True if the current user may replace an existing output.

    In folders with the sticky bit, such as /tmp, only the owners of the output and of the folder may replace it.
    """
    user, target_status, folder = os.geteuid() if hasattr(os, "geteuid") else 0, path.stat(), path.parent.stat()
    if path.is_dir() and not os.access(path, os.W_OK):
        return False
    return not folder.st_mode & stat.S_ISVTX or user in (0, target_status.st_uid, folder.st_uid)


def remove_unfinished(folder: Path) -> None:
    """Cleans up after programs that were killed while writing outputs.

    Deletes the temporary folders of these programs, restores renamed output folders, and finishes moving a complete
    output into `folder` if only a part of it was moved.

    Args:
        folder: Folder of the outputs.
    """
    if fcntl is None:
        return
    with suppress(OSError), _opened_folder(os.fspath(folder), None, follow=True) as parent:
        for name in [entry.name for entry in os.scandir(parent) if _WORKSPACE.fullmatch(entry.name)]:
            # `folder` may be from an untrusted archive that contains imitations of such folders
            with suppress(OSError), _opened_folder(name, parent) as space:
                # folders of running writers are locked
                if _is_workspace(space) and _lock(space):
                    _restore(space, parent)
                    if _finish_moving(space, parent):
                        shutil.rmtree(name, ignore_errors=True, dir_fd=parent)


@functools.lru_cache(maxsize=1024)
def _tidy_once(folder: Path) -> None:
    """Cleans up after killed programs at the first call for a folder (`remove_unfinished`); later calls do nothing."""
    remove_unfinished(folder)


@contextmanager
def _opened_folder(name: str, parent: int | None, *, follow: bool = False) -> Iterator[int]:
    """Context manager that opens a folder of the current user and yields the file descriptor.

    Args:
        name: Name of the folder.
        parent: Open folder that contains it; None for the working directory.
        follow: True to follow a link and to accept the folder of another user.

    Raises:
        OSError: If the name is not that of a folder. Without `follow`, also if the folder is a link or belongs to
            another user.
    """
    handle = os.open(name, os.O_RDONLY | os.O_DIRECTORY | (0 if follow else os.O_NOFOLLOW), dir_fd=parent)
    try:
        if not follow and os.fstat(handle).st_uid != os.geteuid():
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), name)
        yield handle
    finally:
        os.close(handle)


def _is_workspace(space: int) -> bool:
    """True if an open folder is a temporary folder of `atomic_output`, and only the current user can access it.

    Args:
        space: File descriptor of the folder.
    """
    if os.fstat(space).st_mode & 0o077 or not set(os.listdir(space)) <= {_NEW, _OLD, _MOVING}:
        return False
    for part in os.listdir(space):
        with _opened_folder(part, space) as inside:
            names = os.listdir(inside)
        # a restored hidden folder such as .git could make programs run foreign code
        if len(names) > 1 or (part == _OLD and any(name.startswith(".") for name in names)):
            return False
    return True


def _restore(space: int, parent: int) -> None:
    """Moves old output folders back to their original paths, after a program was killed while it replaced them.

    Args:
        space: File descriptor of the temporary folder, to which the killed program had moved the old folders.
        parent: File descriptor of the folder that contains the temporary folder.
    """
    with suppress(OSError), _opened_folder(_OLD, space) as aside:
        for name in os.listdir(aside):
            with suppress(OSError), _opened_folder(name, aside):
                if not _exists(name, parent):
                    os.rename(name, name, src_dir_fd=aside, dst_dir_fd=parent)


def _finish_moving(space: int, parent: int) -> bool:
    """Moves the rest of a complete output into its folder, after a program was killed while it moved the output.

    Args:
        space: File descriptor of the temporary folder.
        parent: File descriptor of the output folder, which contains the temporary folder.

    Returns:
        False if a part could not be moved.
    """
    if not _exists(_MOVING, space):
        return True
    has_moved_all = True
    try:
        with _opened_folder(_MOVING, space) as moving:
            for folder in os.listdir(moving):
                try:
                    with _opened_folder(folder, moving) as rest:
                        has_moved_all &= _move_entries(rest, parent)
                except OSError as error:
                    if error.errno not in _NO_OUTPUT:
                        raise
    except OSError:
        return False
    return has_moved_all


def _exists(name: str, parent: int) -> bool:
    """Returns True if a file, folder or link of that name exists."""
    try:
        os.stat(name, dir_fd=parent, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _move_entries(rest: int, parent: int) -> bool:
    """Moves the entries of an open folder into another one; returns False if one could not be moved."""
    has_moved_all = True
    for entry in list(os.scandir(rest)):  # a list, because entries are moved away
        # outputs have neither hidden files nor links, unlike imitations in untrusted archives
        if not (entry.name.startswith(".") or entry.is_symlink() or _exists(entry.name, parent)):
            try:
                os.rename(entry.name, entry.name, src_dir_fd=rest, dst_dir_fd=parent)
            except OSError:
                has_moved_all = False
    return has_moved_all


@contextmanager
def _workspace(folder: Path) -> Iterator[Path]:
    """Context manager that yields a new hidden folder for unfinished output.

    The folder is locked while the context is active, and removed when the context ends.
    """
    space: Path | None = None
    handle: int | None = None
    try:
        while True:
            space = folder / f"{_START}{uuid.uuid4().hex[:12]}{_END}"
            space.mkdir(mode=0o700)
            if fcntl is None:
                break
            # Race: another process may mistake it for a leftover before it is locked, and lock or remove it.
            with suppress(FileNotFoundError):
                handle = os.open(space, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                if _lock(handle) is not False and os.fstat(handle).st_nlink:
                    break
                os.close(handle)
                handle = None
        yield space
    finally:
        if space is not None:
            try:
                shutil.rmtree(space, ignore_errors=True)
            except BaseException:  # Ctrl-C during the removal
                shutil.rmtree(space, ignore_errors=True)
                raise
        if handle is not None:
            os.close(handle)


def _lock(handle: int) -> bool | None:
    """Tries to lock an open folder.

    Returns False if another process has the lock, None if locks are not supported.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def with_final_names(text: str) -> str:
    """Replaces the temporary paths of unfinished output in a message by their final paths."""
    return _UNFINISHED.sub("", text)


def _flush(file: Path) -> None:
    """Writes the content of a file to the disk; otherwise a power failure could keep the name and lose the content."""
    with file.open("rb") as opened:
        os.fsync(opened.fileno())


def _take_name(new: Path, target: Path, moved_aside: Path) -> None:
    if not new.is_dir():
        _flush(new)
        os.replace(new, target)
        return
    if not target.exists():
        new.rename(target)
        return
    moved_aside.mkdir()
    old = moved_aside / target.name  # moved aside entirely, so that no old file remains among new ones
    try:
        target.rename(old)
        new.rename(target)
    except BaseException:  # also Ctrl-C between the two
        if old.exists() and not target.exists():
            old.rename(target)
        raise


def _must_be_kept(folder: Path) -> bool:
    """True if an empty output folder cannot be replaced by another one, or is the working directory.

    Also true if new files in the folder inherit its group or its access rules.
    """
    if folder.stat().st_mode & stat.S_ISGID:
        return True
    with suppress(OSError, AttributeError):  # macOS and Windows have no such attributes
        if os.getxattr(folder, "system.posix_acl_default"):
            return True
    with suppress(OSError):  # the working directory may have been removed
        if folder.samefile(os.curdir):
            return True
    return os.path.ismount(folder) or not os.access(folder.parent, os.W_OK | os.X_OK) or not _replaceable(folder)


def _replace_empty(new: Path, target: Path) -> None:
    """Replaces an empty folder by a new one with the same owner and permissions, in a single step if possible."""
    status = target.stat()
    try:
        shutil.copystat(target, new)
        os.utime(new)
        if hasattr(os, "chown"):
            os.chown(new, status.st_uid, status.st_gid)
        new.rename(target)
    except OSError:  # such as a bind mount, or a folder that is no longer empty
        with _workspace(target) as space:
            try:
                shutil.copytree(new, space / _NEW / target.name)
            except shutil.Error as error:
                reasons = " ".join(str(reason) for _, _, reason in error.args[0])  # `copytree` keeps their texts only
                code = next((code for code in _FULL if os.strerror(code) in reasons), errno.EIO)
                raise OSError(code, os.strerror(code), str(target)) from error
            _move_into(space, target)


def _move_into(space: Path, target: Path) -> None:
    """Moves the entries of a complete new folder into an existing folder.

    Args:
        space: Temporary folder with the new folder, inside `target`.
        target: The existing folder.
    """
    (space / _NEW).rename(space / _MOVING)  # marks the new folder as complete
    entries = sorted((space / _MOVING / target.name).iterdir())
    try:
        for entry in entries:
            entry.rename(target / entry.name)
    except BaseException:  # also Ctrl-C between two of them
        for moved in (target / entry.name for entry in entries if not entry.exists()):
            shutil.rmtree(moved) if moved.is_dir() else moved.unlink()
        raise
