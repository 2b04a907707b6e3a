"""Estimates queuing delay, baseline loss and congestion loss of a path from receiver reports."""

import math
from collections import deque
from dataclasses import dataclass

BASE_WINDOW_S = 30.0
"""Period over which the minimum one-way delay counts as the delay with an empty queue, seconds."""
LONGEST_QUEUE_WINDOW_S = 10.0
MIN_LATE_REPORTS = 3
"""Number of consecutive reports with long delay that indicate a queue. Fewer can have other causes, such as Wi-Fi."""
MIN_QUEUE_S = 0.004
"""Shortest queuing delay distinguished from noise, seconds."""
HIGH_QUEUE_SHARE, LOW_QUEUE_SHARE = 0.5, 0.3
"""Queuing delays as shares of the longest recent queuing delay: with more than `HIGH_QUEUE_SHARE`, losses may be
congestion; with less than `LOW_QUEUE_SHARE`, losses are not congestion.
"""
BASELINE_DATAGRAMS = 2000.0
"""Number of datagrams over which the baseline loss is averaged."""
MAX_BASELINE_LOSS = 0.3
"""Maximum baseline loss that the control accepts as unrelated to congestion."""
CIRCUIT_BREAKER_LOSS = 0.45
"""Loss rate above which a path is considered congested or broken at any queuing delay (circuit breaker)."""
CIRCUIT_BREAKER_DATAGRAMS = 500
"""Number of datagrams over which the loss rate of the circuit breaker is averaged."""
MIN_LOSS_ROUNDS = 3
"""Minimum number of control rounds with loss for a rise of the loss rate to be significant. A test must last long
enough for this number of rounds with loss to be expected at the loss rate before the test.
"""
VARIANCE_ROUNDS = 16.0
"""Number of control rounds over which the variance of the loss is averaged."""
LOSS_STEP = 0.005
"""Smallest rise of the loss rate that triggers a test."""
BASELINE_TOLERANCE = 1.25
"""Tolerance factor on the baseline loss before a new test, because random loss varies."""


class WindowedMinFilter:
    """Minimum of the values of the last `window_s` seconds.

    Args:
        window_s: Length of the time window, seconds.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._candidates: deque[tuple[float, float]] = deque()

    def add(self, now: float, value: float) -> float:
        """Adds a value that was measured at time `now` (seconds).

        Returns:
            Minimum of all values of the last `window_s` seconds, including the new one.
        """
        while self._candidates and self._candidates[-1][1] >= value:
            self._candidates.pop()
        self._candidates.append((now, value))
        while self._candidates[0][0] < now - self._window_s:
            self._candidates.popleft()
        return self._candidates[0][1]


class QueueMeter:
    """Estimates the queuing delay from one-way delays, without synchronised clocks.

    Attributes:
        delay: Queuing delay of the latest report, seconds.
        max_delay: Longest recent queuing delay, seconds.
    """

    def __init__(self) -> None:
        self._min_transit_filter = WindowedMinFilter(BASE_WINDOW_S)
        self._max_delay_filter = WindowedMinFilter(LONGEST_QUEUE_WINDOW_S)
        self._recent_delays: deque[float] = deque(maxlen=MIN_LATE_REPORTS)
        self.delay = self.max_delay = 0.0

    def add(self, now: float, transit: float) -> float:
        """Adds a one-way delay and returns the queuing delay: excess over the minimum delay, seconds.

        Args:
            now: Time, seconds.
            transit: One-way delay, seconds, plus any constant clock offset.
        """
        self.delay = transit - self._min_transit_filter.add(now, transit)
        self._recent_delays.append(self.delay)
        self.max_delay = -self._max_delay_filter.add(now, -min(self._recent_delays))
        return self.delay

    def is_high(self, delay: float) -> bool:
        """Returns True if a queuing delay (seconds) indicates that the queue may have overflowed."""
        return delay >= max(HIGH_QUEUE_SHARE * self.max_delay, MIN_QUEUE_S)

    def is_low(self, delay: float) -> bool:
        """Returns True if a queuing delay (seconds) is so short that the queue cannot have overflowed."""
        return delay <= max(LOW_QUEUE_SHARE * self.max_delay, MIN_QUEUE_S)


@dataclass
class LossCounter:
    """Counter of sent and lost datagrams over one or more control rounds (about one round trip each).

    Attributes:
        sent: Number of sent datagrams.
        lost: Number of lost datagrams among them.
        events: Number of control rounds in which at least one datagram was lost.
    """

    sent: int = 0
    lost: int = 0
    events: int = 0

    def add(self, other: "LossCounter") -> None:
        """Adds the counts of a second counter to this counter."""
        self.sent += other.sent
        self.lost += other.lost
        self.events += other.events

    @property
    def share(self) -> float:
        """Fraction of the sent datagrams that was lost, 0 to 1."""
        return self.lost / max(self.sent, 1)


class LossMeter:
    """Separates the baseline loss of a path, which is random, from congestion loss.

    The baseline loss is the loss rate that remains in a test at a lower sending rate.

    Attributes:
        baseline: Baseline loss, as a fraction of the sent datagrams.
    """

    def __init__(self) -> None:
        self.baseline = 0.0
        self._max_baseline = 0.0
        self._recent_loss = 0.0
        self._excess_losses = 0.0
        self._variance = 0.0
        self._recent_counts = LossCounter()

    def is_circuit_broken(self, counts: LossCounter) -> bool:
        """Returns True if the recent loss rate exceeds `CIRCUIT_BREAKER_LOSS`.

        The caller then treats the path as congested, even if the queuing delay is short.

        Args:
            counts: Numbers of datagrams sent and lost in the last control round (about one round trip).
        """
        self._recent_loss += min(counts.sent / CIRCUIT_BREAKER_DATAGRAMS, 1.0) * (counts.share - self._recent_loss)
        return self._recent_loss > CIRCUIT_BREAKER_LOSS

    def deviation(self, sent: int) -> float:
        """Returns the maximum number of excess losses that can be due to chance: three standard deviations.

        Excess losses are losses above the expected number.

        Args:
            sent: Number of sent datagrams.
        """
        # Three standard deviations. The variance is measured on this path, so that it includes bursts of losses.
        return 3.0 * math.sqrt(self._variance * sent)

    def is_congested(self, counts: LossCounter) -> bool:
        """Returns True if recent losses are significantly above the baseline loss, which indicates congestion.

        Args:
            counts: Numbers of datagrams sent and lost in one control round (about one round trip), while the queue at
                the bottleneck of the path was long.
        """
        self._excess_losses = max(
            self._excess_losses + counts.lost - BASELINE_TOLERANCE * self.baseline * counts.sent, 0.0
        )
        if self._excess_losses <= 0.5 + self.deviation(counts.sent):
            return False
        self._excess_losses = 0.0
        return True

    def loss_rise(self, counts: LossCounter) -> LossCounter | None:
        """Detects a significant rise of the loss rate while the queue is short, and updates the baseline loss.

        Args:
            counts: Numbers of datagrams sent and lost while the queue was short, in one control round (about one round
                trip).

        Returns:
            Sent and lost datagrams of the recent rounds if their loss rate rose significantly, else None.
        """
        excess = counts.lost - counts.sent * self.baseline
        self.baseline = min(max(self.baseline + excess / BASELINE_DATAGRAMS, 0.0), self._max_baseline)
        if self.baseline:  # else the variation may be congestion
            self._variance += (excess * excess / counts.sent - self._variance) / VARIANCE_ROUNDS
        recent = self._recent_counts
        recent.add(counts)
        threshold = (self.baseline + LOSS_STEP) * recent.sent + self.deviation(recent.sent)
        has_risen = recent.events >= MIN_LOSS_ROUNDS and recent.lost > threshold
        if has_risen or recent.sent > BASELINE_DATAGRAMS:
            self._recent_counts = LossCounter()
        return recent if has_risen else None

    def test_done(self, before: LossCounter, during: LossCounter) -> bool:
        """True if a test at a lower sending rate has lasted long enough to compare loss rates.

        Args:
            before: Sent and lost datagrams before the test.
            during: Sent and lost datagrams during the test so far.
        """
        return during.sent * before.events >= MIN_LOSS_ROUNDS * before.sent

    def finish_test(self, before: LossCounter, during: LossCounter, rate_share: float) -> bool:
        """Evaluates a test at a lower sending rate, and updates the baseline loss if the loss persisted.

        Args:
            before: Sent and lost datagrams before the test.
            during: Sent and lost datagrams during the test.
            rate_share: Sending rate during the test as a share of the rate before the test.

        Returns:
            True if the loss was congestion. This is the case if the loss decreased at the lower rate, or if the loss is
            so high that the path counts as congested anyway. False if the loss persisted at the lower rate. It is then
            random loss of the path.
        """
        self._recent_counts = LossCounter()
        share_if_congested = max(1.0 - (1.0 - before.share) / rate_share, 0.0)
        if before.share > CIRCUIT_BREAKER_LOSS or during.share < 0.5 * (before.share + share_if_congested):
            return True
        is_first, total = not self.baseline, LossCounter()
        total.add(before)
        total.add(during)
        self.baseline = min(total.share, MAX_BASELINE_LOSS)
        if is_first:
            self._variance = self.baseline * total.lost / total.events
        self._max_baseline = min(BASELINE_TOLERANCE * self.baseline + LOSS_STEP, MAX_BASELINE_LOSS)
        return False
