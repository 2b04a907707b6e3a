"""Encoder of unbounded live sequences, which are split into independent streams."""

from collections.abc import Callable
from dataclasses import replace

from splatwire.bitstream import Packet
from splatwire.sequence.encoding import SequenceEncoder
from splatwire.sequence.frames import Frame
from splatwire.sequence.options import SequenceOptions
from splatwire.transport.protocol.live_packager import PROTECTION, LivePackager, LiveSnapshot
from splatwire.transport.protocol.protection import Protection
from splatwire.types.splats import Splats

PERIOD_GROUPS = 120
"""Groups of pictures per period: one minute at 15 frames per group and 30 frames per second. Each period repeats the
keyframe Gaussians.
"""
PERIOD_BYTES = 1 << 26
"""Size in bytes at which a period ends early, because server and receivers have one period in memory."""


class LiveEncoder:
    """Encoder of a live sequence: returns the new state of the stream after each group of pictures.

    The sequence is divided into periods of several groups. Each period is an independent stream.

    Args:
        options: Encoder options.
        new_id: Function that returns a new stream id for each period.
        protection: Redundancy (forward error correction) of the streams.
        period_groups: Groups of pictures per period.
    """

    def __init__(
        self, options: SequenceOptions, new_id: Callable[[], int], protection: Protection = PROTECTION,
        period_groups: int = PERIOD_GROUPS,
    ) -> None:  # fmt: skip
        self._options, self._new_id, self._protection = options, new_id, protection
        self._period_groups = period_groups
        self._newest_state: LiveSnapshot | None = None
        self._begin_period(SequenceEncoder(options, live=True))
        self.num_frames = self._num_in_complete_groups = 0

    def push(self, frame: Frame | Splats) -> LiveSnapshot | None:
        """Adds the next frame; returns the new state of the stream if a group of pictures is complete, else None.

        Raises:
            InvalidValueError: If the frame contradicts earlier frames (see `SequenceEncoder.push`).
        """
        checked_frame = frame if isinstance(frame, Frame) else Frame.of(frame)
        begins_group = not self.num_frames % self._options.group_frames
        # The first group of a period needs a visible Gaussian, and only its first frame is known here.
        if begins_group and self._is_period_full and checked_frame.drawn.any():
            self._begin_period(self.encoder.new_period())
        packets = self.encoder.push(checked_frame)
        self.num_frames += 1
        if self.num_frames % self._options.group_frames:
            return None
        snapshot = self._add(packets)
        self._num_in_complete_groups = self.num_frames
        return snapshot

    def restart(self) -> None:
        """Drops the frames of the incomplete group of pictures. The next frame starts a new, independent stream."""
        self.num_frames = self._num_in_complete_groups
        self._begin_period(self.encoder.restarted(self.num_frames))

    def end(self) -> list[LiveSnapshot]:
        """Ends the live sequence: encodes the remaining frames.

        Returns:
            State of the stream with the remaining frames, if there are any, followed by the final state, which marks
            the end for clients. Empty if the sequence has no frames.

        Raises:
            InvalidValueError: If the remaining frames cannot be encoded (see `SequenceEncoder.push`).
        """
        rest = [self._add(self.encoder.flush())] if self.num_frames % self._options.group_frames else []
        newest = self._newest_state
        return [] if newest is None else [*rest, replace(newest, is_live=False)]

    @property
    def _is_period_full(self) -> bool:
        return self._num_groups >= self._period_groups or self._num_bytes > PERIOD_BYTES

    def _begin_period(self, encoder: SequenceEncoder) -> None:
        self.encoder, self._stream_id = encoder, self._new_id()
        self._packager = LivePackager(self._protection, encoder.importance)
        self._num_groups = self._num_bytes = 0

    def _add(self, packets: list[Packet]) -> LiveSnapshot:
        self._num_groups += 1
        self._num_bytes += sum(packet.num_bytes for packet in packets)
        self._newest_state = self._packager.add(*self.encoder.current_header(self._stream_id), packets)
        return self._newest_state
