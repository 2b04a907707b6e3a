"""Frames that appear while a live clip is encoded: in a folder, or named in a pipe."""

import math
import os
import select
import stat
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

LOOK_S = 0.02
"""Interval between two looks at a folder or a pipe, seconds."""
OLD_S = 1.0
"""A file that was last written so long ago is complete at the first look, seconds."""
QUIET_S = 0.5
"""A file that no reader can tell to be cut is complete when it has not changed for so long, seconds."""
GROWING_S = 10.0
"""Longest time that later frames wait for one that still grows, seconds."""
PATIENCE_S, PATIENCE_BEHIND_S = 3.0, 0.5
"""Time without a change after which an unreadable frame is given up, seconds: with none behind it, and with some."""
MAX_NAMES = 4096
"""Names that are read from a pipe ahead of their frames."""
MAX_NAME_BYTES = 1 << 16
"""Longest line of a pipe."""
SUFFIXES = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")
"""Endings of frames: later frames wait for a file with one of these, and it is reported if it cannot be read."""
UNCHECKED = (".splat",)
"""Endings of formats without a count of rows: half a file is a smaller frame."""
UNFINISHED = (".part", ".partial", ".tmp", ".temp", "~")
"""Endings of files that are renamed when they are complete."""

Signature = tuple[int, int, int]
"""Time of the last change in nanoseconds, bytes, and inode of a file."""


@runtime_checkable
class FrameSource(Protocol):
    """Files that appear.

    Attributes:
        over: Whether none will follow.
    """

    over: bool

    def poll(self, now: float) -> list[Path]:
        """Files that are new and complete, in their order.

        Args:
            now: Time, seconds.
        """

    def took(self, path: Path, signature: "Signature | None") -> None:
        """Notes the state in which a file was read or given up: it is new again when it changes.

        Args:
            path: The file.
            signature: Its signature; None if it is gone, or is to be ignored until it is removed.
        """


class PipeSource:
    """Files named on a pipe, one a line, until it ends.

    Args:
        source: File descriptor of the pipe.
        warn: Called with each problem.
    """

    def __init__(self, source: int, warn: Callable[[str], None]) -> None:
        self._source, self._warn, self._rest = source, warn, b""
        self.over = False

    def poll(self, now: float) -> list[Path]:
        """See `FrameSource.poll`; names that exceed `MAX_NAMES` stay in the pipe."""
        found: list[Path] = []
        while not self.over and len(found) < MAX_NAMES and select.select([self._source], [], [], 0)[0]:
            data = os.read(self._source, 1 << 14)
            self.over = not data
            *lines, self._rest = (self._rest + (data or b"\n")).split(b"\n")
            found += [Path(os.fsdecode(line.strip())) for line in lines if line.strip()]
            if len(self._rest) > MAX_NAME_BYTES:
                self._warn(f"standard input: a line of more than {MAX_NAME_BYTES:,} bytes is no name of a frame")
                self._rest = b""
        return found

    def took(self, path: Path, signature: Signature | None) -> None:
        """See `FrameSource.took`: a file is a frame as often as it is named."""


class FolderSource:
    """Frames of a folder, each as soon as it is complete; a name that is replaced or used again is a new frame.

    Names that begin with a dot or end like `UNFINISHED` are ignored. A file that still grows holds up the later ones,
    for at most `GROWING_S`; then it is given up.

    Args:
        folder: The folder. It may vanish for a while.
        warn: Called with each problem.
        wall: Gives the time of files, seconds since 1970.
    """

    def __init__(self, folder: Path, warn: Callable[[str], None], wall: Callable[[], float] = time.time) -> None:
        self._folder, self._warn, self._wall = folder, warn, wall
        self._done: dict[str, Signature | None] = {}  # None: returned and not read yet, or given up
        self._seen: dict[str, tuple[Signature, float, float]] = {}
        self._reported: set[str] = set()
        self.over = False

    def poll(self, now: float) -> list[Path]:
        """See `FrameSource.poll`."""
        try:
            names = [name for name in os.listdir(self._folder) if not name.startswith(".")]
        except OSError as error:
            self._warn(f"{self._folder}: {error.strerror}; waiting for it")
            return []
        names = [name for name in names if not name.lower().endswith(UNFINISHED)]
        self._forget(set(names))
        return self._complete(self._new(names), now)

    def _new(self, names: list[str]) -> list[tuple[Path, os.stat_result, Signature]]:
        """Files that were not returned as they are now, sorted by name."""
        from splatwire.clips.frames import by_number

        found = []
        for name in names:
            path = self._folder / name
            try:
                status = path.stat()
                signature = signature_of(path, status)
            except FileNotFoundError:
                continue
            except OSError as error:
                if name not in self._reported:
                    self._reported.add(name)
                    self._warn(f"{path}: {error.strerror}: left out")
                continue
            if self._done.get(name, ()) not in (None, signature):
                found.append((path, status, signature))
        return sorted(found, key=lambda item: by_number(item[0]))

    def _complete(self, new: list[tuple[Path, os.stat_result, Signature]], now: float) -> list[Path]:
        from splatwire.clips.frames import is_frame

        ready: list[Path] = []
        held_up = False
        for number, (path, status, signature) in enumerate(new):
            before, changed, first = self._seen.get(path.name, (None, now, now))
            changed = changed if before == signature else now
            self._seen[path.name] = signature, changed, first
            if held_up:
                continue
            frame_like = path.suffix.lower() in SUFFIXES
            behind = number + 1 < len(new)
            if not self._settled(path, status, now - changed, first=before is None, behind=behind):
                held_up = frame_like and not (behind and now - first >= GROWING_S)
                if frame_like and not held_up:
                    self._warn(f"{path} still grows after {GROWING_S:g} s: skipped")
                    self._done[path.name] = None
                continue
            if frame_like or is_frame(path):
                ready.append(path)
                self._done[path.name] = None
            else:
                self._done[path.name] = signature
            del self._seen[path.name]
        return ready

    def took(self, path: Path, signature: Signature | None) -> None:
        """See `FrameSource.took`."""
        if signature is not None and path.name in self._done:
            self._done[path.name] = signature

    def _settled(self, path: Path, status: os.stat_result, quiet: float, *, first: bool, behind: bool) -> bool:
        if first:
            return self._wall() - status.st_mtime > OLD_S
        moved = status.st_ctime_ns > status.st_mtime_ns  # renamed after it was written
        if path.suffix.lower() in UNCHECKED and not moved and not behind:
            return quiet >= QUIET_S
        return quiet > 0

    def _forget(self, names: set[str]) -> None:
        """Forgets files that were removed: their names may be used again."""
        for known in (self._done, self._seen):
            for name in known.keys() - names:
                del known[name]
        self._reported &= names


class Patience:
    """Decides how long an unreadable frame is waited for: its writer may have paused in the middle."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._signature: Signature | None = None
        self._first = self._changed = 0.0

    def is_unchanged(self, path: Path, signature: Signature | None) -> bool:
        """Returns True if reading failed before and the file is the same since: reading it again is in vain."""
        return (self._path, self._signature) == (path, signature)

    def note(self, path: Path, signature: Signature | None, now: float) -> None:
        """Takes note that reading a file failed, which was changed since the last failure."""
        self._first = self._first if self._path == path else now
        self._path, self._signature, self._changed = path, signature, now

    def is_over(self, now: float, *, behind: bool) -> bool:
        """Returns True if the frame that failed last is to be given up.

        Args:
            now: Time, seconds.
            behind: Whether later frames wait.
        """
        if self._signature is None or (behind and self.grows(now)):
            return True
        return now - self._changed >= (PATIENCE_BEHIND_S if behind else PATIENCE_S)

    def grows(self, now: float) -> bool:
        """Returns True if the frame has failed for `GROWING_S`: it is to be ignored until it is removed."""
        return now - self._first >= GROWING_S

    def clear(self) -> None:
        """Forgets the frame: it was read or given up."""
        self._path = self._signature = None


class Backlog:
    """Bounds the frames that wait to be encoded: a standing queue is cut, one that drains is not.

    Frames that lie in a folder from the beginning, or are copied into it at once, are played at their rate. A queue of
    more than a second that does not drain is delay that would never shrink.

    Args:
        rate: Frames per second.
        group_frames: Frames of a group.
    """

    STANDING_S, WINDOW_S, DRAIN, KEEP_S = 1.0, 2.0, 0.25, 0.1

    def __init__(self, rate: float, group_frames: int) -> None:
        self._rate = rate
        self._limit = max(math.ceil(rate * self.STANDING_S), 2 * group_frames)
        self._keep = math.ceil(rate * self.KEEP_S)
        self._lengths: deque[tuple[float, int]] = deque()

    def surplus(self, waiting: int, now: float) -> int:
        """Number of frames to drop, the oldest ones.

        Args:
            waiting: Frames that wait.
            now: Time, seconds.
        """
        if waiting <= self._limit:
            self._lengths.clear()
            return 0
        self._lengths.append((now, waiting))
        if now - self._lengths[0][0] < self.WINDOW_S:
            return 0
        passed, length = self._lengths.popleft()
        drained = length - waiting
        if drained >= self.DRAIN * self._rate * (now - passed):
            return 0
        self._lengths.clear()
        return waiting - self._keep


def signature_of(path: Path, status: os.stat_result) -> Signature:
    """Facts by which a change of a file, or of the files of a folder, is noticed.

    Raises:
        OSError: If the folder cannot be read.
    """
    if not stat.S_ISDIR(status.st_mode):
        return status.st_mtime_ns, status.st_size, status.st_ino
    inside = [entry.stat() for entry in os.scandir(path)]
    newest = max((status.st_mtime_ns, *(one.st_mtime_ns for one in inside)))
    return newest, sum(one.st_size for one in inside), status.st_ino


def signature_at(path: Path) -> Signature | None:
    """Signature of a file; None if there is none."""
    try:
        return signature_of(path, path.stat())
    except (OSError, ValueError):
        return None
