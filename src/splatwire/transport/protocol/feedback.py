"""Evaluates a receiver's reports on the sender: round-trip times, delays and loss."""

from collections import deque
from typing import NamedTuple

from splatwire.transport.protocol.messages import Feedback

MIN_LARGE_BYTES = 600
"""Minimum size of a large datagram, bytes."""
MAX_STORED_SEND_TIMES = 8192
"""Number of latest datagrams whose sending times are stored."""


class FeedbackSample(NamedTuple):
    """Delay and loss between two successive reports of the receiver; input of the rate control.

    Each report names the latest datagram that the receiver has got. Let A be the datagram that the first report names,
    and B the one that the second report names. The sample covers the datagrams that were sent after A, up to B.

    Attributes:
        round_trip: Round-trip time of B, seconds.
        transit: One-way delay of B, seconds, plus an unknown constant clock offset.
        num_sent: Number of covered datagrams.
        num_arrived: Number of covered datagrams that were received.
        bytes_arrived: Estimated total size of the covered datagrams that were received, bytes.
        seconds: Time between the arrivals of A and B, seconds.
    """

    round_trip: float
    transit: float
    num_sent: int
    num_arrived: int
    bytes_arrived: float
    seconds: float


class ReportedCounts(NamedTuple):
    """Counts of datagrams up to the latest one that the receiver has reported.

    Attributes:
        num_sent: Number of datagrams sent.
        num_received: Number of these datagrams that were received.
        num_large: Number of these datagrams with at least `MIN_LARGE_BYTES` bytes.
    """

    num_sent: int
    num_received: int
    num_large: int


class FeedbackTracker:
    """Stores when datagrams were sent, and evaluates the receiver's reports.

    Attributes:
        sequence: Sequence number of the next datagram.
    """

    def __init__(self) -> None:
        self.sequence = 0
        self._num_bytes = self._clock = 0
        self._times: deque[tuple[int, float, int]] = deque(maxlen=MAX_STORED_SEND_TIMES)
        self._last: Feedback | None = None
        self._num_large = self._num_large_reported = 0

    @property
    def has_unreported(self) -> bool:
        """True if datagrams were sent after the latest datagram that the receiver has reported."""
        return self.sequence - 1 > (self._last.largest if self._last else -1)

    @property
    def reported_counts(self) -> ReportedCounts:
        """Counts of datagrams up to the latest one that the receiver has reported; all 0 before the first report."""
        if self._last is None:
            return ReportedCounts(0, 0, 0)
        return ReportedCounts(self._last.largest + 1, self._last.received, self._num_large_reported)

    def on_sent(self, num_bytes: int, now: float) -> None:
        """Records the time (seconds) and the size of a datagram that is being sent."""
        self._num_large += num_bytes >= MIN_LARGE_BYTES
        self._times.append((self.sequence, now, self._num_large))
        self.sequence += 1
        self._num_bytes += num_bytes

    def is_plausible(self, message: Feedback) -> bool:
        """Returns True if the counters of a report do not decrease, and do not exceed the number of datagrams sent."""
        last = self._last
        grows = last is None or (message.largest >= last.largest and message.received >= last.received)
        return grows and message.received <= message.largest + 1 and message.largest < max(self.sequence, 1)

    def on_feedback(self, message: Feedback, now: float) -> FeedbackSample | None:
        """Returns delay and loss since the previous report.

        Args:
            message: Report of the receiver, already checked for impossible values.
            now: Time, seconds.

        Returns:
            The measurement; None if unknown, such as for the first report.
        """
        times, last = self._times, self._last
        if last is not None and message.largest == last.largest:
            return None
        while times and times[0][0] < message.largest:
            times.popleft()
        self._last = message
        if times and times[0][0] == message.largest:
            self._num_large_reported = times[0][2]
        if not times or times[0][0] != message.largest or last is None:
            return None
        sent, arrived = message.largest - last.largest, message.received - last.received
        mean, seconds = self._num_bytes / max(self.sequence, 1), ((message.time_us - last.time_us) & 0xFFFFFFFF) / 1e6
        transit = self._unwrapped(message.time_us) - times[0][1]
        return FeedbackSample(now - times[0][1], transit, sent, min(arrived, sent), arrived * mean, seconds)

    def _unwrapped(self, time_us: int) -> float:
        """Converts the receiver's 32-bit clock (microseconds) to seconds, and corrects overflows of the 32 bits."""
        self._clock += ((time_us - self._clock + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
        return self._clock / 1e6
