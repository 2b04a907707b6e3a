"""What a client's reports say of what left: numbers for the rate control, if they can be true."""

from collections import deque
from typing import NamedTuple

from splatwire.transport.frames import Feedback

RECENT = 8192
"""Datagrams whose sending time is remembered."""


class Measured(NamedTuple):
    """What happened between two reports, as `RateControl.on_feedback` takes it, behind the time.

    Attributes:
        round_trip: Of the latest datagram that arrived, seconds.
        transit: Of the same, by the receiver's clock and ours: seconds, with any offset.
        num_sent: Datagrams sent between those that the two name.
        num_arrived: How many of them arrived.
        bytes_arrived: About how many bytes that was.
        seconds: Time between the arrivals.
    """

    round_trip: float
    transit: float
    num_sent: int
    num_arrived: int
    bytes_arrived: float
    seconds: float


class Reports:
    """Numbers datagrams and remembers when they left.

    Attributes:
        sequence: Number of the next one.
    """

    def __init__(self) -> None:
        self.sequence = 0
        self._num_bytes = self._clock = 0
        self._times: deque[tuple[int, float]] = deque(maxlen=RECENT)
        self._last: Feedback | None = None

    @property
    def awaited(self) -> bool:
        """Whether something left that no report has named."""
        return self.sequence - 1 > (self._last.largest if self._last else -1)

    def left(self, num_bytes: int, now: float) -> None:
        """Counts a datagram that leaves now."""
        self._times.append((self.sequence, now))
        self.sequence += 1
        self._num_bytes += num_bytes

    def believable(self, frame: Feedback) -> bool:
        """Whether the counts of a report can be true."""
        last = self._last
        grows = last is None or (frame.largest >= last.largest and frame.received >= last.received)
        return grows and frame.received <= frame.largest + 1 and frame.largest < max(self.sequence, 1)

    def take(self, frame: Feedback, now: float) -> Measured | None:
        """What happened since the last report; None where that cannot be told."""
        times, last = self._times, self._last
        if last is not None and frame.largest == last.largest:
            return None
        while times and times[0][0] < frame.largest:
            times.popleft()
        self._last = frame
        if not times or times[0][0] != frame.largest or last is None:
            return None
        sent, arrived = frame.largest - last.largest, frame.received - last.received
        mean, seconds = self._num_bytes / max(self.sequence, 1), ((frame.time_us - last.time_us) & 0xFFFFFFFF) / 1e6
        transit = self._unwrapped(frame.time_us) - times[0][1]
        return Measured(now - times[0][1], transit, sent, min(arrived, sent), arrived * mean, seconds)

    def _unwrapped(self, time_us: int) -> float:
        """The receiver's clock in seconds, which does not begin again every 71 minutes."""
        self._clock += ((time_us - self._clock + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
        return self._clock / 1e6
