"""Live encoding: reads, encodes and serves each new frame."""

import gc
import os
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from splatwire.errors import MALFORMED, BackendUnavailableError, SplatwireError
from splatwire.sequence import SequenceOptions, read_frames
from splatwire.sequence.frame_sources import (
    POLL_INTERVAL_S,
    DropPolicy,
    FrameSource,
    Signature,
    UnreadableFrame,
    signature_at,
)
from splatwire.sequence.frames import Frame
from splatwire.transport.protocol.live_packager import LiveSnapshot
from splatwire.types.origin import Origin, describe_origin
from splatwire.types.validity import validity_of_splats

NUM_FRAMES_TO_ADOPT = 15
"""Number of consecutive frames with a different degree of harmonics, antialiasing or distant origin after which the
sequence adopts their settings. Independent of the length of groups.
"""
FRAME_ERRORS = (SplatwireError, OSError, MemoryError, EOFError, *MALFORMED)
"""Exceptions that concern a single frame; encoding continues with the next frame."""


class _FrameKind(NamedTuple):
    """Properties that all frames of a sequence share.

    Attributes:
        degree: Degree of the spherical harmonics.
        antialiased: True for antialiased drawing.
        origin: World coordinates of a point near all Gaussians.
    """

    degree: int
    antialiased: bool
    origin: Origin


@runtime_checkable
class LiveFrameEncoder(Protocol):
    """Typing protocol (structural type) for an encoder of a live sequence, which takes one frame at a time."""

    @property
    def num_frames(self) -> int:
        """Number of frames taken, those of the incomplete group included."""

    def push(self, frame: Frame) -> LiveSnapshot | None:
        """Encodes a frame, and returns the new state of the stream if the frame completes a group, else None."""

    def restart(self) -> None:
        """Discards the frames of the incomplete group; the next frame starts a new stream."""

    def end(self) -> Iterable[LiveSnapshot]:
        """Encodes the remaining frames, and returns the resulting states of the stream."""


class LiveIngest:
    """Encodes the frames of a source at the frame rate.

    Args:
        source: Source of the frames' files.
        encoder: The live encoder.
        options: Encoder options.
        publish: Called with the new state of the stream after each group of pictures.
        stop: Returns True if encoding should end.
        warn: Called with the text of each warning.
        clock: Returns the current time, seconds.
        sleep: Waits for the given number of seconds.

    Attributes:
        num_skipped: Number of skips: unusable frames, and groups that cannot be encoded (each group counts as 1).
        num_dropped: Number of frames dropped because they arrive faster than they are encoded.
    """

    def __init__(
        self, source: FrameSource, encoder: LiveFrameEncoder, options: SequenceOptions,
        publish: Callable[[LiveSnapshot], None], stop: Callable[[], bool], warn: Callable[[str], None],
        *, clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:  # fmt: skip
        self._source, self._encoder, self._options, self._publish = source, encoder, options, publish
        self._stop, self._warn, self._clock, self._sleep = stop, warn, clock, sleep
        self._rate = float(options.rate)
        self._queue: deque[Path] = deque()
        self._drop_policy, self._unreadable = DropPolicy(self._rate, options.group_frames), UnreadableFrame()
        self._frame_kind: _FrameKind | None = None
        self._has_visible = False  # of the frames with these properties
        self._num_of_other_kind, self._reason = 0, ""
        self.num_skipped = self.num_dropped = 0

    @property
    def num_frames(self) -> int:
        """Number of frames taken, those of the incomplete group included."""
        return self._encoder.num_frames

    def run(self) -> None:
        """Encodes frames until the source ends or a stop is requested.

        Raises:
            BackendUnavailableError: If forward error correction is requested and the package `raptorq` is not
                installed.
        """
        due, max_delay = self._clock(), self._options.group_frames / self._rate
        while not self._stop():
            self._queue_new_files()
            if not self._queue:
                if self._source.ended:
                    break
                self._wait(POLL_INTERVAL_S)
                continue
            frame = self._next_frame()
            if frame is None:
                continue
            due = max(due, self._clock() - max_delay)  # catches up after encoding a group, but not after a pause
            if self._push(frame):
                due += 1 / self._rate
                self._wait(due - self._clock())
        try:
            final = self._encoder.end()
        except FRAME_ERRORS as error:
            self._skip_group(error)
            final = self._encoder.end()
        for state in final:
            self._publish(state)

    def _queue_new_files(self) -> None:
        """Adds new files to the queue of frames; removes the oldest frames if the queue is too long."""
        now = self._clock()
        self._queue.extend(self._source.poll(now))
        surplus = 0 if self._source.ended else self._drop_policy.surplus(len(self._queue), now)
        for _ in range(surplus):
            dropped = self._queue.popleft()
            self._source.mark_read(dropped, signature_at(dropped))
        if surplus:
            self.num_dropped += surplus
            self._warn(
                f"{surplus:,} frames dropped ({self.num_dropped:,} so far): they come faster than they are encoded "
                f"or than {self._rate:g} a second"
            )

    def _next_frame(self) -> Frame | None:
        """Reads the next file of the queue, and returns its frame.

        Returns None if the file cannot be used now. An unreadable file may be incomplete, and is tried again later. If
        it stays unreadable for too long, it is skipped. A readable frame that does not fit the previous frames is
        skipped at once.
        """
        path, now = self._queue[0], self._clock()
        signature = signature_at(path)
        if not self._unreadable.is_unchanged(path, signature):
            try:
                frame = next(read_frames([path]))
            except FRAME_ERRORS as error:
                self._reason = _reason(error)
                self._unreadable.record_failure(path, signature, now)
            else:
                self._remove_first(signature)
                return self._accept(path, frame)
        if self._unreadable.is_expired(now, blocks_others=len(self._queue) > 1):
            self._remove_first(None if self._unreadable.is_still_written(now) else signature)
            self._skip(self._reason if str(path) in self._reason else f"{path}: {self._reason}")
        else:
            self._wait(POLL_INTERVAL_S)
        return None

    def _remove_first(self, signature: Signature | None) -> None:
        """Removes the first file from the queue and marks the file as read.

        Args:
            signature: State of the file when it was read (`signature_at`), so that a later change is noticed. None to
                ignore the file for as long as it exists.
        """
        self._unreadable.clear()
        self._source.mark_read(self._queue.popleft(), signature)

    def _accept(self, path: Path, frame: Frame) -> Frame | None:
        """Accepts a frame that can follow the previous frames; returns None if it must be skipped.

        After `NUM_FRAMES_TO_ADOPT` frames in a row with another degree or antialiasing than before, or too far from the
        origin of the frames before, the encoder starts again with the last of them.
        """
        count = frame.splats.num_gaussians
        if count and not _has_valid_rows(frame):
            self._skip(f"{path}: none of its {count:,} Gaussians can be drawn")
            return None
        kind = _kind_of(frame, self._frame_kind)
        before = self._frame_kind
        has_only_new_origin = before is not None and kind._replace(origin=before.origin) == before
        if has_only_new_origin and not self._has_visible and frame.is_visible:
            self._adopt_first_origin(kind.origin)
        if self._frame_kind in (None, kind):
            self._frame_kind, self._num_of_other_kind = kind, 0
            self._has_visible |= frame.is_visible
            return frame
        assert self._frame_kind is not None
        self._num_of_other_kind += 1
        if self._num_of_other_kind < NUM_FRAMES_TO_ADOPT:
            self._skip(
                f"{path} has {_frame_properties(kind)}, frames before have {_frame_properties(self._frame_kind)}"
            )
            return None
        self._warn(
            f"{path}: {NUM_FRAMES_TO_ADOPT} frames in a row have {_frame_properties(kind)}: the stream continues with "
            "these frames"
        )
        self._encoder.restart()
        self._frame_kind, self._num_of_other_kind = kind, 0
        self._has_visible = frame.is_visible
        return frame

    def _adopt_first_origin(self, origin: Origin) -> None:
        """Sets the origin to that of the first visible frame, after empty frames, which have no meaningful origin."""
        assert self._frame_kind is not None
        if origin != self._frame_kind.origin and self._encoder.num_frames >= self._options.group_frames:
            self._encoder.restart()  # so that no empty frame has chosen an origin
        self._frame_kind = self._frame_kind._replace(origin=origin)

    def _push(self, frame: Frame) -> bool:
        """Encodes a frame, and publishes the group of pictures if the frame completes it.

        Returns:
            True if the frame was accepted. False if encoding failed; the frames of the group are then skipped.
        """
        try:
            state = self._encoder.push(frame)
        except FRAME_ERRORS as error:
            self._skip_group(error)
            return False
        if self._encoder.num_frames == self._options.group_frames:
            gc.freeze()  # scanning the objects of all modules would delay a group by 0.1 s
        if state is not None:
            self._publish(state)
        return True

    def _skip_group(self, error: Exception) -> None:
        """Drops the frames of a group of pictures that could not be encoded.

        Raises:
            BackendUnavailableError: If the reason is a missing package.
        """
        if isinstance(error, BackendUnavailableError):
            raise error
        self._skip(f"a group of frames could not be encoded: {_reason(error)}")
        self._encoder.restart()

    def _skip(self, why: str) -> None:
        self.num_skipped += 1
        self._warn(f"{why}: skipped, {self.num_skipped:,} so far")

    def _wait(self, seconds: float) -> None:
        """Waits for `seconds`, or until a stop is requested."""
        end = self._clock() + seconds
        while not self._stop() and (remaining := end - self._clock()) > 0:
            self._sleep(min(remaining, 0.1))


def _has_valid_rows(frame: Frame) -> bool:
    """True if at least one Gaussian of a frame has valid values."""
    return bool(frame.drawn.any()) or validity_of_splats(frame.splats).num_invalid < frame.splats.num_gaussians


def _kind_of(frame: Frame, before: _FrameKind | None) -> _FrameKind:
    """Returns the properties of a frame that must be the same in all frames of a sequence.

    Args:
        frame: The frame.
        before: Properties of the frames before; None for the first frame. Their origin is the result's origin, too, if
            the positions of the frame's visible Gaussians relative to it are precise.
    """
    origin = frame.origin if before is None or not frame.fits_origin(before.origin) else before.origin
    return _FrameKind(frame.splats.degree, frame.antialiased, origin)


def _frame_properties(kind: _FrameKind) -> str:
    """Describes the properties of a frame that must be the same in all frames of a sequence, for messages."""
    antialiasing = "antialiasing" if kind.antialiased else "no antialiasing"
    return f"harmonics of degree {kind.degree}, {antialiasing} and positions near {describe_origin(kind.origin)}"


def _reason(error: Exception) -> str:
    """Returns the text of an exception in one line."""
    is_expected = isinstance(error, (SplatwireError, OSError))
    return str(error) if is_expected and str(error) else f"{type(error).__name__}: {error}".rstrip(": ")


def new_stream_id() -> int:
    """Returns a random id for a stream, 32 bits."""
    return int.from_bytes(os.urandom(4), "little")
