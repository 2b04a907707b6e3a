"""Frames of a clip that is sent live, written while it comes, beside the loop that receives it."""

import queue
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from splatwire.cli._files import STREAM_SUFFIX

if TYPE_CHECKING:
    from splatwire.clips import ClipFrame
    from splatwire.transport import Event

DIGITS = 6
"""Of the number in a frame's name: nobody knows yet how many there will be."""


class LiveFrames:
    """Takes no part in a stream that is whole from the beginning, nor where one is to be recorded.

    Args:
        path: Where frames are written, a folder; recorded streams have the ending of one file.
        concealer: What becomes of tracks whose motion was lost; None for the default.
        show: Told what is going on.
    """

    def __init__(self, path: Path, concealer: str | None, show: Callable[[str, float], None]) -> None:
        self._folder, self._concealer, self._show = path, concealer, show
        self._waiting: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        self.num_frames = 0

    @property
    def began(self) -> bool:
        """Whether the stream is one that grows, whose frames are written."""
        return self._thread is not None

    def note(self, event: "Event") -> None:
        """Takes an event of the receiver.

        Raises:
            SplatwireError: What went wrong with an earlier one.
        """
        from splatwire.transport import Welcomed

        if self._error is not None:
            raise self._error
        if isinstance(event, Welcomed) and event.open and not self.began and self._folder.suffix != STREAM_SUFFIX:
            self._folder.mkdir(exist_ok=True)
            self._thread = threading.Thread(target=self._work, name="frames", daemon=True)
            self._thread.start()
        if self.began:
            self._waiting.put(event)

    def finish(self) -> None:
        """Waits until everything that came is written.

        Raises:
            SplatwireError: What went wrong.
        """
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.join()
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "LiveFrames":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.put(None)

    def _work(self) -> None:
        from splatwire.clips.concealers import DEFAULT
        from splatwire.clips.live import LiveDecoder, frames_in_turn

        try:
            self._write(frames_in_turn(LiveDecoder(self._concealer or DEFAULT), self._waiting))
        except Exception as error:  # raised where the stream is received
            self._error = error

    def _write(self, frames: "Iterable[ClipFrame]") -> None:
        from splatwire.formats import write_splats

        last, offset = -1, 0
        for frame in frames:
            if frame.number + offset <= last:  # a server that was started again counts from 0
                offset = last + 1 - frame.number
            last = frame.number + offset
            scene, path = frame.scene, self._folder / f"frame_{last:0{DIGITS}}.ply"
            write_splats([scene.drawn()], path, antialiased=scene.antialiased, origin=scene.origin)
            self.num_frames += 1
            self._show("writing frames", 0.0)
