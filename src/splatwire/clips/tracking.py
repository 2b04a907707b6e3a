"""Which Gaussian of a frame is which of the frame before."""

from dataclasses import dataclass, replace

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.clips.frames import Frame
from splatwire.clips.grouping import NamedFrame
from splatwire.clips.matching import Match, aligned, match, tracked
from splatwire.errors import InvalidValueError
from splatwire.scene.splats import Splats

ORDERS = ("auto", "tracked", "shuffled")
SECTION = "tracking"
"""Name of the section of the side information that says how frames were told to belong together."""
_SHARE = 1_000_000


@dataclass(frozen=True)
class TrackingReport:
    """How the frames of a clip were told to belong together.

    Attributes:
        tracked: Frames whose rows keep their Gaussian.
        matched: Frames whose Gaussians had to be matched.
        share: Share of the Gaussians of matched frames that found a partner; 1 where there are none.
        born: Gaussians that came after the first frame.
    """

    tracked: int = 0
    matched: int = 0
    share: float = 1.0
    born: int = 0

    def section(self) -> bytes:
        """As a section: frames that kept their rows, frames that were matched, millionths that matched, born ones."""
        writer = ByteWriter()
        for value in (self.tracked, self.matched, round(self.share * _SHARE), self.born):
            writer.unsigned(value)
        return writer.bytes()

    @staticmethod
    def read(section: bytes) -> "TrackingReport":
        """The inverse of `section`.

        Raises:
            BitstreamError: If it is damaged.
        """
        reader = ByteReader(section, f"section '{SECTION}'")
        tracked, matched, share, born = (reader.unsigned() for _ in range(4))
        reader.finish()
        return TrackingReport(tracked, matched, share / _SHARE, born)


class Tracker:
    """Names the Gaussians of frames, one frame after another.

    Args:
        order: `tracked` if row i is the same Gaussian in every frame, `shuffled` if rows say nothing, `auto` to find
            out for each frame.

    Raises:
        InvalidValueError: If there is no such order.
    """

    def __init__(self, order: str = "auto") -> None:
        if order not in ORDERS:
            raise InvalidValueError(f"frames are {', '.join(ORDERS)}, not {order!r:.40}")
        self._order, self._next = order, 0
        self._rows: Splats | None = None
        self._keys = np.zeros(0, np.int64)
        self._last: NamedFrame | None = None
        self._match: Match | None = None
        self.report = TrackingReport()

    def add(self, frame: Frame) -> NamedFrame:
        """Names the Gaussians of the next frame.

        Raises:
            InvalidValueError: If rows shall be the same Gaussians and their number changes.
        """
        named = self._first(frame) if self._last is None else self._next_frame(frame)
        self._rows, self._last = frame.splats, named
        return named

    def rename(self) -> np.ndarray:
        """Names the Gaussians of the last frame anew, so that names do not grow for ever.

        Returns:
            Their names before, ascending, int64: what was the n-th of these is called n from here on.
        """
        assert self._last is not None
        old = np.unique(self._last.keys)
        self._last = replace(self._last, keys=np.searchsorted(old, self._last.keys))
        self._keys = np.where(self._keys >= 0, np.searchsorted(old, self._keys), -1)
        self._next = len(old)
        return old

    def _first(self, frame: Frame) -> NamedFrame:
        self._keys = np.full(frame.splats.num_gaussians, -1, np.int64)
        return self._by_rows(frame, count=False)

    def _next_frame(self, frame: Frame) -> NamedFrame:
        assert self._rows is not None
        assert self._last is not None
        same = frame.splats.num_gaussians == self._rows.num_gaussians
        if self._order == "tracked" and not same:
            raise InvalidValueError(
                f"a frame has {frame.splats.num_gaussians:,} Gaussians, the one before "
                f"{self._rows.num_gaussians:,}: rows of tracked frames are always the same Gaussians"
            )
        if self._order == "tracked" or (self._order == "auto" and same and tracked(self._rows, frame.splats)):
            self._match = None
            self.report = replace(self.report, tracked=self.report.tracked + 1)
            return self._by_rows(frame, count=True)
        return self._matched(frame)

    def _by_rows(self, frame: Frame, count: bool) -> NamedFrame:
        """Rows keep their names; one that was not drawn begins anew."""
        keys = np.where(frame.drawn, self._keys, -1)
        new = frame.drawn & (keys < 0)
        keys[new] = self._fresh(int(new.sum()), count)
        self._keys = keys
        return NamedFrame(_drawn(frame), keys[frame.drawn])

    def _matched(self, frame: Frame) -> NamedFrame:
        """Names go to partners one to one."""
        assert self._last is not None
        here = _drawn(frame)
        found = match(self._last.splats, here, self._match)
        old, keys = found.partner >= 0, found.partner.copy()
        keys[old] = self._last.keys[keys[old]]
        keys[~old] = self._fresh(int((~old).sum()), born=True)
        self._keys = np.full(frame.splats.num_gaussians, -1, np.int64)
        self._keys[frame.drawn], self._match = keys, found
        number, share = self.report.matched, float(old.mean()) if len(old) else 1.0
        mean = (self.report.share * number + share) / (number + 1)
        self.report = replace(self.report, matched=number + 1, share=mean)
        return NamedFrame(aligned(self._last.splats, here, found.partner), keys)

    def _fresh(self, count: int, born: bool) -> np.ndarray:
        first, self._next = self._next, self._next + count
        if born:
            self.report = replace(self.report, born=self.report.born + count)
        return np.arange(first, first + count)


def _drawn(frame: Frame) -> Splats:
    """What of a frame draws something; itself where all does, for copying takes as long as reading."""
    return frame.splats if frame.drawn.all() else frame.splats.select(frame.drawn)
