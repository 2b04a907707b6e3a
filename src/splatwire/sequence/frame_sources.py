"""Files of frames that appear while a live sequence is encoded: from a folder or from a pipe."""

import itertools
import math
import os
import select
import stat
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from splatwire.sequence.frames import by_number, is_frame

POLL_INTERVAL_S = 0.02
"""Interval between two checks of the folder or pipe, seconds."""
COMPLETE_AGE_S = 1.0
"""Age of a file's last change from which the file counts as complete at the first check, seconds."""
UNCHANGED_S = 0.5
"""Time without change after which a file counts as complete if its format does not reveal truncation, seconds."""
MAX_CHECK_INTERVAL_S = 1.0
"""Maximum time between two checks of the folder that counts as waiting, seconds; the rest of a pause does not."""
GROWING_TIMEOUT_S = 10.0
"""Maximum time that later frames wait for a frame whose file still grows, seconds."""
UNREADABLE_TIMEOUT_S = 3.0
"""Time without a change after which an unreadable frame is skipped, seconds."""
UNREADABLE_TIMEOUT_QUEUED_S = 0.5
"""Time without a change after which an unreadable frame is skipped if later frames wait for it, seconds."""
MAX_CHANGES_OF_OTHERS = 16
"""Maximum number of changes of a file or folder that is no frame; after more, it is ignored until it is removed."""
MAX_ENTRIES = 4096
"""Maximum number of entries of a folder that are checked for changes; no frame has as many files."""
LISTING_INTERVAL_S = 5e-6
"""Minimum interval between two listings of a folder, seconds per entry, so that a folder with many old frames does not
take the processor time of the encoder.
"""
RECHECK_INTERVAL_S = 40e-6
"""Minimum interval between two checks of all earlier files for changes, seconds per file."""
MAX_NAMES = 4096
"""Number of file names after which one `PipeSource.poll` stops reading the pipe."""
MAX_NAME_BYTES = 1 << 16
"""Maximum length of a line of the pipe, bytes."""
FRAME_SUFFIXES = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")
"""File name suffixes of frames: later frames wait for such a file, and a warning is logged if the file is
unreadable."""
SUFFIXES_WITHOUT_COUNT = (".splat",)
"""Suffixes of formats without a stored number of Gaussians: a truncated file would be read as a smaller frame."""
TEMPORARY_SUFFIXES = (".part", ".partial", ".tmp", ".temp", "~")
"""Suffixes of temporary files that their writers rename when the files are complete."""

Signature = tuple[int, int, int]
"""Time of the last change in nanoseconds, size in bytes, and inode of a file."""
NO_FILE: Signature = (0, -1, 0)
"""Signature of a missing file; differs from that of every file."""


@runtime_checkable
class FrameSource(Protocol):
    """Source of the files of a sequence's frames, in the order of playback.

    Attributes:
        ended: True if no further file will appear.
    """

    ended: bool

    def poll(self, now: float) -> list[Path]:
        """Returns the files that are complete and were not returned before.

        Args:
            now: Current time, seconds.
        """

    def mark_read(self, path: Path, signature: Signature | None) -> None:
        """Records that a file was read or is ignored.

        Args:
            path: The file.
            signature: State of the file when it was read (`signature_at`). None to ignore the file until it is removed.
        """


class PipeSource:
    """Source of frames whose file names are written to a pipe, one name per line.

    Args:
        source: File descriptor of the pipe.
        warn: Called with the text of each warning.
    """

    def __init__(self, source: int, warn: Callable[[str], None]) -> None:
        self._source, self._warn, self._rest = source, warn, b""
        self.ended = False

    def poll(self, now: float) -> list[Path]:
        """Returns the frame files whose names have been read from the pipe since the previous call."""
        paths: list[Path] = []
        while not self.ended and len(paths) < MAX_NAMES and select.select([self._source], [], [], 0)[0]:
            data = os.read(self._source, 1 << 14)
            self.ended = not data
            *lines, self._rest = (self._rest + (data or b"\n")).split(b"\n")
            paths += [Path(os.fsdecode(line.strip())) for line in lines if line.strip()]
            if len(self._rest) > MAX_NAME_BYTES:
                self._warn(f"standard input: a line of more than {MAX_NAME_BYTES:,} bytes is no name of a frame")
                self._rest = b""
        return paths

    def mark_read(self, path: Path, signature: Signature | None) -> None:
        """Does nothing, because each name in the pipe is a new frame, even if the same name was read before."""


class _PendingFile(NamedTuple):
    """File that may still grow, with the times of the last change and of the first listing, seconds."""

    signature: Signature
    changed_at: float
    first_seen_at: float


class FolderSource:
    """Source of the frames in a folder: each new or replaced file is a new frame.

    A frame is returned when its file no longer grows.

    Args:
        folder: The folder; it may be missing temporarily.
        warn: Called with the text of each warning.
        wall_clock: Returns the current time, seconds since 1970.
    """

    def __init__(self, folder: Path, warn: Callable[[str], None], wall_clock: Callable[[], float] = time.time) -> None:
        self._folder, self._warn, self._wall_clock = folder, warn, wall_clock
        self._processed: dict[str, Signature | None] = {}  # None: returned but not read yet, or given up
        self._pending: dict[str, _PendingFile] = {}
        self._num_changes: dict[str, int] = {}
        self._reported: set[str] = set()
        self._listed_at = self._rechecked_at = -math.inf
        self._num_names = 0
        self.ended = False

    def poll(self, now: float) -> list[Path]:
        """Returns the files that are complete and were not returned before, sorted by name.

        Between two listings of a folder, at least 5 ms per 1,000 files pass. A new file is returned after two listings,
        which show that it no longer grows, or after one listing if its last change is older than `COMPLETE_AGE_S`.
        Changes of earlier files are found within 40 ms per 1,000 files, plus the time of one listing.
        """
        if now - self._listed_at < self._num_names * LISTING_INTERVAL_S:
            return []
        try:
            names = set(os.listdir(self._folder))
        except OSError as error:
            self._warn(f"{self._folder}: {error.strerror}; waiting for it")
            return []
        # A frame that nothing checked for a while, such as during compilation, may be complete already.
        paused = now - self._listed_at - MAX_CHECK_INTERVAL_S
        if self._pending and paused > 0:
            self._pending = {
                name: file._replace(first_seen_at=file.first_seen_at + paused) for name, file in self._pending.items()
            }
        self._listed_at, self._num_names = now, len(names)
        self._forget(names)
        candidates = (names - self._processed.keys()) | self._pending.keys()
        if now - self._rechecked_at >= len(self._processed) * RECHECK_INTERVAL_S:
            self._rechecked_at = now
            candidates = names
        return self._select_complete(self._new(candidates), now)

    def _new(self, names: Iterable[str]) -> list[tuple[Path, os.stat_result, Signature]]:
        """Selects the files that are new or have changed since they were read; returns them sorted by name."""
        new_files, folder = [], str(self._folder)
        for name in names:  # no Path for each: a folder has many files
            if name.startswith(".") or name.lower().endswith(TEMPORARY_SUFFIXES):
                continue
            known = self._processed.get(name, NO_FILE)
            if known is None:
                continue
            location = os.path.join(folder, name)
            try:
                status = os.stat(location)
                signature = signature_of(location, status)
            except FileNotFoundError:
                continue
            except OSError as error:
                if name not in self._reported:
                    self._reported.add(name)
                    self._warn(f"{location}: {error.strerror}: left out")
                continue
            if known != signature:
                new_files.append((Path(location), status, signature))
        return sorted(new_files, key=lambda item: by_number(item[0]))

    def _select_complete(self, new: list[tuple[Path, os.stat_result, Signature]], now: float) -> list[Path]:
        """Returns the files that no longer grow, in order.

        A frame that still grows holds back later ones for at most `GROWING_TIMEOUT_S`.
        """
        ready: list[Path] = []
        is_blocked = False
        for number, (path, status, signature) in enumerate(new):
            before = self._pending.get(path.name)
            changed_at = before.changed_at if before is not None and before.signature == signature else now
            first_seen_at = now if before is None else before.first_seen_at
            self._pending[path.name] = _PendingFile(signature, changed_at, first_seen_at)
            if is_blocked:
                continue
            frame_like = path.suffix.lower() in FRAME_SUFFIXES
            has_later = number + 1 < len(new)
            if not self._is_complete(path, status, now - changed_at, is_first=before is None, has_later=has_later):
                is_blocked = frame_like and not (has_later and now - first_seen_at >= GROWING_TIMEOUT_S)
                if frame_like and not is_blocked:
                    self._warn(f"{path} still grows after {GROWING_TIMEOUT_S:g} s: skipped")
                    self._processed[path.name] = None
                elif not frame_like and now - first_seen_at >= GROWING_TIMEOUT_S:
                    self._give_up(path)
                continue
            if frame_like or is_frame(path):
                ready.append(path)
                self._processed[path.name] = None
            else:
                self._processed[path.name] = signature
                self._num_changes[path.name] = self._num_changes.get(path.name, 0) + 1
                if self._num_changes[path.name] > MAX_CHANGES_OF_OTHERS:
                    self._give_up(path)
            del self._pending[path.name]
        return ready

    def _give_up(self, path: Path) -> None:
        self._processed[path.name] = None
        self._warn(f"{path} is no frame and keeps changing: ignored until it is removed")

    def mark_read(self, path: Path, signature: Signature | None) -> None:
        """Records that a frame's file was read or is ignored, so that `poll` does not return the file again.

        Args:
            path: The file.
            signature: State of the file when it was read (`signature_at`), so that a changed file is returned again;
                `NO_FILE` if the file was missing. None to ignore the file until it is removed.
        """
        if signature is not None and path.name in self._processed:
            self._processed[path.name] = signature

    def _is_complete(
        self, path: Path, status: os.stat_result, unchanged: float, *, is_first: bool, has_later: bool
    ) -> bool:
        """True if a file is probably complete.

        Args:
            path: The file.
            status: Status of the file, as returned by `os.stat`.
            unchanged: Time since the last change of the file, seconds.
            is_first: True at the first check of this file.
            has_later: True if later frames exist.
        """
        if is_first:
            return self._wall_clock() - status.st_mtime > COMPLETE_AGE_S
        moved = status.st_ctime_ns > status.st_mtime_ns  # renamed after it was written
        if path.suffix.lower() in SUFFIXES_WITHOUT_COUNT and not moved and not has_later:
            return unchanged >= UNCHANGED_S
        return unchanged > 0

    def _forget(self, names: set[str]) -> None:
        """Removes deleted files from the records of processed and waiting files.

        Args:
            names: Names of the files that exist.
        """
        for records in (self._processed, self._pending, self._num_changes):
            for name in records.keys() - names:
                del records[name]
        self._reported &= names


class UnreadableFrame:
    """Record of failed attempts to read the file of one frame, which another program may still be writing."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._signature: Signature | None = None
        self._first = self._changed = 0.0

    def is_unchanged(self, path: Path, signature: Signature | None) -> bool:
        """True if reading the file failed before and the file has not changed since."""
        return (self._path, self._signature) == (path, signature)

    def record_failure(self, path: Path, signature: Signature | None, now: float) -> None:
        """Records a failed attempt to read a frame file.

        Args:
            path: The file.
            signature: State of the file at this attempt (`signature_at`).
            now: Time of the attempt, seconds.
        """
        self._first = self._first if self._path == path else now
        self._path, self._signature, self._changed = path, signature, now

    def is_expired(self, now: float, *, blocks_others: bool) -> bool:
        """True if a frame is skipped: its file is missing, or has stayed unreadable for too long.

        Args:
            now: Current time, seconds.
            blocks_others: True if later frames wait for this frame.
        """
        if self._signature in (None, NO_FILE) or (blocks_others and self.is_still_written(now)):
            return True
        return now - self._changed >= (UNREADABLE_TIMEOUT_QUEUED_S if blocks_others else UNREADABLE_TIMEOUT_S)

    def is_still_written(self, now: float) -> bool:
        """True if the file has been unreadable for so long that another program probably keeps writing it.

        The time since the first failed attempt to read the file is then at least `GROWING_TIMEOUT_S`.

        Args:
            now: Current time, seconds.
        """
        return now - self._first >= GROWING_TIMEOUT_S

    def clear(self) -> None:
        """Deletes the record of failed attempts to read a frame file."""
        self._path = self._signature = None


class DropPolicy:
    """Policy of a live encoder for dropping frames that wait too long, which limits the delay of the stream.

    Args:
        rate: Frames per second.
        group_frames: Number of frames of a group of pictures.
    """

    MAX_QUEUE_S = 1.0
    """Duration of the queued frames above which frames may be dropped, seconds; at least that of two groups."""
    WINDOW_S = 2.0
    """Time that the queue must stay longer than the limit, seconds."""
    MIN_DRAIN_RATE = 0.25
    """Decrease of the queue, as a share of the frame rate, from which no frame is dropped."""
    KEPT_S = 0.1
    """Duration of the frames that are kept after others were dropped, seconds."""

    def __init__(self, rate: float, group_frames: int) -> None:
        self._rate = rate
        # Frames are dropped if more than one second and more than two groups of pictures wait, and the queue does not
        # shrink.
        self._limit = max(math.ceil(rate * self.MAX_QUEUE_S), 2 * group_frames)
        self._keep = math.ceil(rate * self.KEPT_S)
        self._lengths: deque[tuple[float, int]] = deque()

    def surplus(self, waiting: int, now: float) -> int:
        """Returns the number of frames to drop, starting with the oldest.

        Args:
            waiting: Number of frames in the queue.
            now: Current time, seconds.
        """
        if waiting <= self._limit:
            self._lengths.clear()
            return 0
        self._lengths.append((now, waiting))
        if now - self._lengths[0][0] < self.WINDOW_S:
            return 0
        passed, length = self._lengths.popleft()
        drained = length - waiting
        if drained >= self.MIN_DRAIN_RATE * self._rate * (now - passed):
            return 0
        self._lengths.clear()
        return waiting - self._keep


def signature_of(path: str | Path, status: os.stat_result) -> Signature:
    """Returns the signature of a file or folder: three numbers for noticing a change of the content.

    The numbers are modification time (nanoseconds), size (bytes) and inode. For a folder, the time is the newest
    modification time of the folder and its files, and the size is the total size of its files.

    Args:
        path: The file or folder.
        status: Status of the file or folder, as returned by `os.stat`.

    Raises:
        OSError: If the folder cannot be read.
    """
    if not stat.S_ISDIR(status.st_mode):
        return status.st_mtime_ns, status.st_size, status.st_ino
    # For a folder: the newest modification time of its files, their total size, and its own inode.
    with os.scandir(path) as entries:
        children = [entry.stat() for entry in itertools.islice(entries, MAX_ENTRIES)]
    newest = max((status.st_mtime_ns, *(one.st_mtime_ns for one in children)))
    return newest, sum(one.st_size for one in children), status.st_ino


def signature_at(path: Path) -> Signature | None:
    """Returns the signature of a file or folder (`signature_of`).

    Returns `NO_FILE` if the path is missing, and None if it cannot be read.
    """
    try:
        return signature_of(path, path.stat())
    except (FileNotFoundError, NotADirectoryError):
        return NO_FILE
    except (OSError, ValueError):
        return None
