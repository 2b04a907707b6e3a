"""Tracking: gives a Gaussian the same key in all frames in which it occurs."""

from dataclasses import dataclass, replace

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.errors import InvalidValueError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.lazy_names import renamed_attributes
from splatwire.sequence.frames import Frame
from splatwire.sequence.matching import Match, aligned, has_same_order, match
from splatwire.sequence.options import FRAME_ORDERS
from splatwire.sequence.partial_tracks import TrackedFrame
from splatwire.types.splats import Splats

SECTION = "tracking"
"""Name of the side information section with the tracking statistics."""
_SHARE_UNITS = 1_000_000
"""Stored integer of a share of 1."""


@dataclass(frozen=True)
class TrackingReport(CheckedFields):
    """Statistics on tracking: finding the same Gaussian again in each frame of a sequence.

    Attributes:
        num_same_order_frames: Number of frames with the same order of Gaussians as the previous frame.
        num_matched_frames: Number of frames with Gaussians matched to the previous frame by position and appearance.
        matched_share: Mean fraction of Gaussians with a match in matched frames.
        num_births: Number of Gaussians that appear after the first frame.
    """

    num_same_order_frames: int = 0
    num_matched_frames: int = 0
    matched_share: float = 1.0
    num_births: int = 0

    __getattr__ = renamed_attributes("TrackingReport", {
        "tracked": "num_same_order_frames", "matched": "num_matched_frames", "share": "matched_share",
        "born": "num_births",
    })  # fmt: skip

    def section(self) -> bytes:
        """Serialises the statistics as a section of the side information."""
        writer = ByteWriter()
        share = round(self.matched_share * _SHARE_UNITS)
        for value in (self.num_same_order_frames, self.num_matched_frames, share, self.num_births):
            writer.unsigned(value)
        return writer.bytes()

    @staticmethod
    def read(section: bytes) -> "TrackingReport":
        """Parses the statistics from a section written by `TrackingReport.section`.

        Raises:
            BitstreamError: If the section is damaged.
        """
        reader = ByteReader(section, f"section '{SECTION}'")
        num_same_order, num_matched, share, num_births = (reader.unsigned() for _ in range(4))
        reader.finish()
        return TrackingReport(num_same_order, num_matched, share / _SHARE_UNITS, num_births)


class Tracker:
    """Gives the same Gaussian the same key in all frames of a sequence.

    Frames are added in order, one at a time.

    Args:
        order: `tracked` if the i-th Gaussian is the same in every frame, `shuffled` if frames have different orders,
            `auto` to detect the order for each frame.

    Raises:
        InvalidValueError: If the order is unknown.
    """

    def __init__(self, order: str = "auto") -> None:
        if order not in FRAME_ORDERS:
            raise InvalidValueError(f"frames are {', '.join(FRAME_ORDERS)}, not {order!r:.40}")
        self._order, self._next_key = order, 0
        self._previous_splats: Splats | None = None
        self._keys = np.zeros(0, np.int64)
        self._last: TrackedFrame | None = None
        self._match: Match | None = None
        self.report = TrackingReport()

    def add(self, frame: Frame) -> TrackedFrame:
        """Adds the next frame, and returns its Gaussians with the keys of their tracks.

        Raises:
            InvalidValueError: If the order is `tracked` and the number of Gaussians changes.
        """
        tracked_frame = self._first_frame(frame) if self._last is None else self._next_frame(frame)
        self._previous_splats, self._last = frame.splats, tracked_frame
        return tracked_frame

    def renumber(self) -> np.ndarray:
        """Renumbers the tracks of the last frame from 0, in the order of their keys.

        Returns:
            Previous keys in ascending order, int64. Entry n is the previous key of the track that now has key n.
        """
        assert self._last is not None
        old = np.unique(self._last.keys)
        self._last = replace(self._last, keys=np.searchsorted(old, self._last.keys))
        self._keys = np.where(self._keys >= 0, np.searchsorted(old, self._keys), -1)
        self._next_key = len(old)
        return old

    def _first_frame(self, frame: Frame) -> TrackedFrame:
        self._keys = np.full(frame.splats.num_gaussians, -1, np.int64)
        return self._by_index(frame, count_births=False)

    def _next_frame(self, frame: Frame) -> TrackedFrame:
        assert self._previous_splats is not None
        assert self._last is not None
        has_same_count = frame.splats.num_gaussians == self._previous_splats.num_gaussians
        if self._order == "tracked" and not has_same_count:
            raise InvalidValueError(
                f"a frame has {frame.splats.num_gaussians:,} Gaussians, the one before "
                f"{self._previous_splats.num_gaussians:,}: rows of tracked frames are always the same Gaussians"
            )
        if self._order == "tracked" or (
            self._order == "auto" and has_same_count and has_same_order(self._previous_splats, frame.splats)
        ):
            self._match = None
            self.report = replace(self.report, num_same_order_frames=self.report.num_same_order_frames + 1)
            return self._by_index(frame, count_births=True)
        return self._matched(frame)

    def _by_index(self, frame: Frame, *, count_births: bool) -> TrackedFrame:
        """Gives each Gaussian of a frame the track key of the Gaussian with the same index in the previous frame.

        Args:
            frame: The frame.
            count_births: True to count Gaussians that were not visible in the previous frame as new, in the statistics.
        """
        keys = np.where(frame.drawn, self._keys, -1)
        # Gaussians that were invisible in the previous frame get new keys.
        new = frame.drawn & (keys < 0)
        keys[new] = self._new_keys(int(new.sum()), count_births=count_births)
        self._keys = keys
        return TrackedFrame(_drawn(frame), keys[frame.drawn])

    def _matched(self, frame: Frame) -> TrackedFrame:
        """Matches a frame's Gaussians to the previous frame. Each gets the track key of its match, or a new key."""
        assert self._last is not None
        current = _drawn(frame)
        matches = match(self._last.splats, current, self._match)
        is_matched, keys = matches.partner >= 0, matches.partner.copy()
        keys[is_matched] = self._last.keys[keys[is_matched]]
        keys[~is_matched] = self._new_keys(int((~is_matched).sum()), count_births=True)
        self._keys = np.full(frame.splats.num_gaussians, -1, np.int64)
        self._keys[frame.drawn], self._match = keys, matches
        num_frames, share = self.report.num_matched_frames, float(is_matched.mean()) if len(is_matched) else 1.0
        mean = (self.report.matched_share * num_frames + share) / (num_frames + 1)
        self.report = replace(self.report, num_matched_frames=num_frames + 1, matched_share=mean)
        return TrackedFrame(aligned(self._last.splats, current, matches.partner), keys)

    def _new_keys(self, count: int, *, count_births: bool) -> np.ndarray:
        first, self._next_key = self._next_key, self._next_key + count
        if count_births:
            self.report = replace(self.report, num_births=self.report.num_births + count)
        return np.arange(first, first + count)


def _drawn(frame: Frame) -> Splats:
    """Returns the visible Gaussians of a frame."""
    return frame.splats if frame.drawn.all() else frame.splats.select(frame.drawn)
