"""Encoding of frames while they appear: what cannot be used is skipped, and delay does not grow."""

import gc
import logging
import os
import select
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.cli._arriving import LOOK_S, Backlog, FrameSource, Patience, Signature, signature_at
from splatwire.errors import MALFORMED, BackendUnavailableError, SplatwireError

if TYPE_CHECKING:
    from splatwire.clips import ClipOptions
    from splatwire.clips.chapters import EndlessClip
    from splatwire.clips.frames import Frame
    from splatwire.transport import Program

WARN_S = 5.0
"""Least time between two warnings, seconds; those between are counted."""
OTHERS = 15
"""Consecutive frames with another degree of harmonics, or antialiasing, after which the clip goes on with theirs."""
MAX_WARNING = 1000
"""Characters of a warning."""
UNUSABLE = (SplatwireError, OSError, MemoryError, EOFError, *MALFORMED)
"""Errors of a frame that the next frame need not have."""
LOGGERS = ("splatwire.scene.rows", "splatwire.codec.schemas.gaussians.outliers")
"""Loggers that may say something of each frame."""


class Warnings:
    """Prints warnings on standard error, at most one each `WARN_S`; it never waits for a reader.

    Args:
        clock: Gives the time, seconds.
        show: Prints a line.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, show: Callable[[str], None] | None = None) -> None:
        self._clock, self._show = clock, show or print_if_read
        self._next_at = -float("inf")
        self._held = 0

    def __call__(self, text: str) -> None:
        """Prints a warning, or counts it."""
        now = self._clock()
        if now < self._next_at:
            self._held += 1
            return
        more = f" ({self._held:,} other warnings since the last one)" if self._held else ""
        self._show(f"splatwire: warning: {' '.join(text.split())[:MAX_WARNING]}{more}")
        self._next_at, self._held = now + WARN_S, 0


def print_if_read(text: str) -> None:
    """Prints a line on standard error, unless that is a pipe that is full: its reader would stop the clip."""
    try:
        writable = bool(select.select([], [sys.stderr], [], 0)[1])
    except (OSError, ValueError, TypeError, AttributeError):  # not a file of the system
        writable = sys.stderr is not None
    if writable:
        print(text, file=sys.stderr, flush=True)


class LiveEncoding:
    """Encodes frames of a source at their rate until it is over or the stream is stopped.

    Args:
        source: Gives files of frames.
        clip: Encodes them.
        options: How frames are encoded.
        renew: Called with each new state of what is served.
        stop: Returns True when it is time to end.
        warn: Called with each problem.
        clock: Gives the time, seconds.
        sleep: Waits for some seconds.

    Attributes:
        num_skipped: Frames that could not be used.
        num_dropped: Frames that were left out because encoding is slower than their rate.
    """

    def __init__(
        self, source: FrameSource, clip: "EndlessClip", options: "ClipOptions", renew: "Callable[[Program], None]",
        stop: Callable[[], bool], warn: Callable[[str], None], *, clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:  # fmt: skip
        self._source, self._clip, self._options, self._renew = source, clip, options, renew
        self._stop, self._warn, self._clock, self._sleep = stop, warn, clock, sleep
        self._rate = float(options.rate)
        self._waiting: deque[Path] = deque()
        self._backlog, self._patience = Backlog(self._rate, options.group_frames), Patience()
        self._kind: tuple[int, bool] | None = None
        self._others, self._reason = 0, ""
        self.num_skipped = self.num_dropped = 0

    @property
    def num_frames(self) -> int:
        """Frames that were encoded."""
        return self._clip.num_frames

    def run(self) -> None:
        """Encodes until the end.

        Raises:
            BackendUnavailableError: If parity is asked for and the package `raptorq` is not installed.
        """
        due, behind = self._clock(), self._options.group_frames / self._rate
        while not self._stop():
            self._look()
            if not self._waiting:
                if self._source.over:
                    break
                self._wait(LOOK_S)
                continue
            frame = self._next_frame()
            if frame is None:
                continue
            due = max(due, self._clock() - behind)  # the time that coding a group takes is made up for, a pause is not
            if self._push(frame):
                due += 1 / self._rate
                self._wait(due - self._clock())
        for edition in self._clip.end():
            self._renew(edition)

    def _look(self) -> None:
        """Takes files that are new, and drops the oldest where too many wait."""
        now = self._clock()
        self._waiting.extend(self._source.poll(now))
        surplus = 0 if self._source.over else self._backlog.surplus(len(self._waiting), now)
        for _ in range(surplus):
            dropped = self._waiting.popleft()
            self._source.took(dropped, signature_at(dropped))
        if surplus:
            self.num_dropped += surplus
            self._warn(
                f"{surplus:,} frames dropped ({self.num_dropped:,} so far): they come faster than they are encoded "
                f"or than {self._rate:g} a second"
            )

    def _next_frame(self) -> "Frame | None":
        """Reads the next file; None if it is skipped, or waited for."""
        from splatwire.clips import read_frames

        path, now = self._waiting[0], self._clock()
        signature = signature_at(path)
        if not self._patience.is_unchanged(path, signature):
            try:
                frame = next(read_frames([path]))
            except UNUSABLE as error:
                self._reason = _reason(error)
                self._patience.note(path, signature, now)
            else:
                self._take(signature)
                return self._checked(path, frame)
        if self._patience.is_over(now, behind=len(self._waiting) > 1):
            self._take(None if self._patience.grows(now) else signature)
            self._skip(self._reason if str(path) in self._reason else f"{path}: {self._reason}")
        else:
            self._wait(LOOK_S)
        return None

    def _take(self, signature: "Signature | None") -> None:
        """Takes the first file that waits from the queue."""
        self._patience.clear()
        self._source.took(self._waiting.popleft(), signature)

    def _checked(self, path: Path, frame: "Frame") -> "Frame | None":
        """A frame that fits those before; None if it is skipped."""
        count, kind = frame.splats.num_gaussians, (frame.splats.degree, frame.antialiased)
        if count and not _has_valid_rows(frame):
            self._skip(f"{path}: none of its {count:,} Gaussians can be drawn")
            return None
        if self._kind in (None, kind):
            self._kind, self._others = kind, 0
            return frame
        assert self._kind is not None
        self._others += 1
        if self._others < OTHERS:
            self._skip(f"{path} has {_described(kind)}, frames before have {_described(self._kind)}")
            return None
        self._warn(f"{path}: {OTHERS} frames have {_described(kind)}: the clip goes on with them")
        self._clip.restart()
        self._kind, self._others = kind, 0
        return frame

    def _push(self, frame: "Frame") -> bool:
        """Encodes a frame; returns False if its group is dropped because it cannot be encoded."""
        try:
            edition = self._clip.push(frame)
        except BackendUnavailableError:
            raise
        except UNUSABLE as error:
            self._skip(f"a group of frames could not be encoded: {_reason(error)}")
            self._clip.restart()
            return False
        if self._clip.num_frames == self._options.group_frames:
            gc.freeze()  # to look at all that modules and kernels made would hold a group up by a tenth of a second
        if edition is not None:
            self._renew(edition)
        return True

    def _skip(self, why: str) -> None:
        self.num_skipped += 1
        self._warn(f"{why}: skipped, {self.num_skipped:,} so far")

    def _wait(self, seconds: float) -> None:
        """Waits, but not beyond a stop."""
        end = self._clock() + seconds
        while not self._stop() and (left := end - self._clock()) > 0:
            self._sleep(min(left, 0.1))


def _has_valid_rows(frame: "Frame") -> bool:
    """Returns True if a row can be drawn or is transparent, and not all are damaged."""
    from splatwire.scene.rows import rows_of_splats

    return bool(frame.drawn.any()) or rows_of_splats(frame.splats).num_invalid < frame.splats.num_gaussians


def _described(kind: tuple[int, bool]) -> str:
    """The degree of harmonics and the antialiasing of a frame, in words."""
    degree, antialiased = kind
    return f"harmonics of degree {degree} and {'antialiasing' if antialiased else 'no antialiasing'}"


def _reason(error: Exception) -> str:
    """An error in one line."""
    known = isinstance(error, (SplatwireError, OSError))
    return str(error) if known and str(error) else f"{type(error).__name__}: {error}".rstrip(": ")


class _Passed(logging.Filter):
    """Passes warnings on to a function instead of to the handlers of a logger."""

    def __init__(self, warn: Callable[[str], None]) -> None:
        super().__init__()
        self._warn = warn

    def filter(self, record: logging.LogRecord) -> bool:
        """Returns False: nothing else is done with a record."""
        if record.levelno >= logging.WARNING:
            self._warn(record.getMessage())
        return False


@contextmanager
def few_warnings(warn: Callable[[str], None]) -> Iterator[None]:
    """Has loggers that say something of each frame go through a function that limits the rate."""
    passed, loggers = _Passed(warn), [logging.getLogger(name) for name in LOGGERS]
    for logger in loggers:
        logger.addFilter(passed)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(passed)


def new_stream_id() -> int:
    """A random stream id, 32 bits."""
    return int.from_bytes(os.urandom(4), "little")
