"""How fast to send: a rate control that yields to queues, not to random loss."""

from collections import deque
from dataclasses import dataclass

START_RATE = 1.0e6
"""Bytes per second before the first feedback: 8 Mbit/s."""
MIN_RATE = 2.0e4
MAX_RATE = 1.25e8
QUEUE_S = 0.025
"""Standing queue that is tolerated, seconds."""
LOSS_STEP = 0.12
"""Loss this far above the path's usual loss is taken for a full link."""
GROW_START, GROW = 1.5, 1.03
DRAIN_SHARE, FULL_SHARE = 0.75, 0.97
"""Of what the path carries: sent while its queue drains, and once it has."""
DRAINED_S = 0.008


@dataclass
class Pacer:
    """Says when the next datagram may leave.

    Attributes:
        rate: Bytes per second.
        burst_s: Time's worth of datagrams that may leave at once after a pause.
    """

    rate: float
    burst_s: float = 0.004
    _free_at: float = 0.0

    def next_at(self) -> float:
        """Earliest time of the next datagram."""
        return self._free_at

    def sent(self, num_bytes: int, now: float) -> None:
        """Counts a datagram that leaves now."""
        self._free_at = max(self._free_at, now - self.burst_s) + num_bytes / self.rate


class RateControl:
    """Chooses the rate from feedback.

    A path that loses datagrams at random loses them at any rate; a full path delays them (its queue grows) or, without
    a queue, loses more than it used to. So the rate grows until the round trip grows by `QUEUE_S`, or until loss rises
    by `LOSS_STEP` above its usual level; loss alone never stops it (a Reno or Cubic sender would stop at some percent).

    Args:
        start: First rate, bytes per second.
        most: Largest rate, bytes per second.
    """

    def __init__(self, start: float = START_RATE, most: float = MAX_RATE) -> None:
        self.rate = min(start, most)
        self.round_trip: float | None = None
        self.loss = 0.0
        self._most = most
        self._usual_loss = 0.0
        self._least: deque[tuple[float, float]] = deque()
        self._starting = True
        self._draining = False
        self._num_sent = 0
        self._capacity = self.rate
        self._arrived_rates: deque[float] = deque(maxlen=8)
        self._held_until = 0.0

    def on_feedback(
        self, now: float, round_trip: float, num_sent: int, num_arrived: int, bytes_arrived: float, seconds: float
    ) -> None:
        """Takes one feedback.

        Args:
            now: Time, seconds.
            round_trip: Of the latest datagram that arrived, seconds.
            num_sent: Datagrams sent between those that the last and this feedback name.
            num_arrived: How many of them arrived.
            bytes_arrived: About how many bytes that was.
            seconds: Time between the arrivals.
        """
        while self._least and self._least[-1][1] >= round_trip:
            self._least.pop()
        self._least.append((now, round_trip))
        while self._least[0][0] < now - 10.0:
            self._least.popleft()
        least = self._least[0][1]
        self.round_trip = round_trip if self.round_trip is None else 0.8 * self.round_trip + 0.2 * round_trip
        if num_sent < 16:
            return
        loss = max(0.0, 1.0 - num_arrived / num_sent)
        self.loss += (0.15 if self._num_sent else 1.0) * (loss - self.loss)
        self._num_sent += num_sent
        if self._num_sent < 400:  # what is lost at a modest rate is what this path loses
            self._usual_loss = self.loss
        full = self.loss > self._usual_loss + LOSS_STEP
        if not full:
            self._usual_loss += 0.03 * (self.loss - self._usual_loss)
        self._arrived_rates.append(bytes_arrived / max(seconds, 1e-3))
        queue = round_trip - least
        if self._draining:
            self._drain(queue)
        elif now >= self._held_until:
            self._adjust(now, queue > QUEUE_S, full)

    def _drain(self, queue: float) -> None:
        """Sends less than the path carries until its queue is gone, then as much as it carries."""
        if queue < DRAINED_S:
            self._draining = False
            self.rate = max(FULL_SHARE * self._capacity, MIN_RATE)

    def _adjust(self, now: float, queued: bool, full: bool) -> None:
        """Grows, or finds that the path is full."""
        wait = max(self.round_trip or 0.0, 0.02)
        if queued or full:
            carried = (
                max(self._arrived_rates) if self._starting else sum(self._arrived_rates) / len(self._arrived_rates)
            )
            self._capacity = min(carried / max(1.0 - self._usual_loss, 0.3), self.rate)
            self._draining, self._starting = queued, False
            self.rate = max(DRAIN_SHARE * self._capacity, MIN_RATE)
            self._held_until = now + wait
            if full:  # should it not go away, it is what this path loses now
                self._usual_loss += 0.2 * (self.loss - self._usual_loss)
        else:
            self.rate = min(self.rate * (GROW_START if self._starting else GROW), self._most)
            self._held_until = now + wait
