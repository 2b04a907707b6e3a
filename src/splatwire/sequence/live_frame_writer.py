"""Writes the frames of a live sequence while it is received."""

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.sequence.waiting_events import WaitingEvents
from splatwire.transport import Event, Welcomed

LOG = logging.getLogger(__name__)


class LiveFrameWriter:
    """Decodes a live stream during reception, and writes one file per frame.

    If decoding and writing are slower than the stream for minutes, packets are dropped, and a warning is logged.

    Args:
        path: Output folder; created if it does not exist. If the path has the suffix of a stream file (`.swz`), no
            frames are written.
        concealer: Concealer for tracks with lost motion; None for the default.
        show: Called with progress messages.
    """

    def __init__(self, path: Path, concealer: str | None, show: Callable[[str, float], None]) -> None:
        self._folder, self._concealer, self._show = path, concealer, show
        self._waiting = WaitingEvents()
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        self.num_dropped = 0
        """Number of received packets that were dropped, because frames were written too slowly."""

    @property
    def writes_frames(self) -> bool:
        """True if frames of a live stream are written: the path does not have the suffix of a stream file."""
        return self._folder.suffix.lower() != FILE_SUFFIX

    @property
    def began(self) -> bool:
        """True if the received stream is live and the writing of its frames has begun."""
        return self._thread is not None

    def on_event(self, event: Event) -> None:
        """Passes an event of the receiver to the thread that writes frames.

        Raises:
            SplatwireError: If writing an earlier frame failed.
        """
        if self._error is not None:
            raise self._error
        if isinstance(event, Welcomed) and event.is_live and not self.began and self.writes_frames:
            self._folder.mkdir(exist_ok=True)
            self._thread = threading.Thread(target=self._work, name="frames", daemon=True)
            self._thread.start()
        if self.began and not self._waiting.put(event):
            if not self.num_dropped:
                LOG.warning("frames are written more slowly than they arrive: packets are dropped")
            self.num_dropped += 1

    def finish(self) -> None:
        """Waits until all received frames are written.

        Raises:
            SplatwireError: If writing a frame failed.
        """
        if self._thread is not None:
            self._waiting.end()
            self._thread.join()
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "LiveFrameWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.end()

    def _work(self) -> None:
        from splatwire.sequence.frame_writer import write_live_frames  # takes a second; packets arrive meanwhile

        try:
            write_live_frames(self._waiting, self._folder, self._concealer, self._show_progress)
        except Exception as error:  # raised again by `on_event` and `finish`
            self._error = error

    def _show_progress(self) -> None:
        self._show("writing frames", 0.0)
