"""Pacing and rate control of a sender, which reacts to queuing delay and congestion, not to random loss."""

import math
from dataclasses import dataclass, field

from splatwire.transport.congestion.cubic import INITIAL_WINDOW, MIN_WINDOW, CubicWindow
from splatwire.transport.congestion.path import BASELINE_TOLERANCE, LossCounter, LossMeter, QueueMeter

START_RATE = 1.0e6
"""Maximum rate before the first feedback, bytes per second (8 Mbit/s)."""
MAX_RATE = 1.25e8
ASSUMED_ROUND_TRIP_S = 0.1
"""Round-trip time assumed before the first measurement, seconds."""
MAX_QUEUE_S, DRAINED_QUEUE_S = 0.025, 0.008
"""Queuing delays, seconds: above the first, the sender drains the queue if there are no competing flows; below the
second, the queue counts as drained.
"""
MAX_START_QUEUE_S = 0.01
"""Queuing delay that ends slow start, seconds (RFC 9406)."""
ASSUMED_BASELINE_LOSS = 0.2
"""Loss rate tolerated in slow start before the baseline loss is known; a congested path soon loses more."""
DRAIN_RATE_SHARE, CRUISE_RATE_SHARE = 0.75, 0.9
"""Sending rates as shares of the path's capacity: while the queue is drained, and afterwards."""
PROBE_RATE_SHARE = 0.5
"""Sending rate, as a share of the path's capacity, during a probe for competing flows."""
TEST_RATE_SHARE = 0.6
"""Sending rate during a test, as a share of the rate before the test. The test shows whether the loss depends on the
rate.
"""
MIN_PROBE_INTERVAL_S, MAX_PROBE_INTERVAL_S = 15.0, 80.0
"""Minimum and maximum interval between probes for competing flows, seconds. Not a multiple of 10 s, the period in which
BBR reduces its rate: if both flows reduce their rates together, this flow loses its fair share.
"""
MIN_ROUND_S = 0.02
"""Minimum length of a control round, seconds: the interval of receiver reports."""
FEEDBACK_TIMEOUT_S, FEEDBACK_TIMEOUT_ROUNDS = 0.2, 4.0
"""Time without feedback after which the rate is halved, repeatedly: in seconds, and in round trips. The larger applies.
"""
DATAGRAM = 1200
MIN_RATE = 2.4e3
"""Minimum sending rate without feedback, bytes per second."""


@dataclass
class Pacer:
    """Token-bucket pacer: computes when the next datagram may be sent.

    Attributes:
        rate: Sending rate, bytes per second.
        burst_s: Maximum burst after a pause, as seconds of sending at the current rate.
        datagrams_wait: True while datagrams wait for this pacer. HTTP responses with the same pacer then pause, so that
            both get a share of the rate.
    """

    rate: float
    burst_s: float = 0.004
    datagrams_wait: bool = False
    _free_at: float = 0.0

    def next_at(self) -> float:
        """Returns the earliest time at which the next datagram may be sent, seconds."""
        return self._free_at

    def sent(self, num_bytes: int, now: float) -> None:
        """Counts a datagram of `num_bytes` bytes, sent at time `now` (seconds)."""
        self._free_at = max(self._free_at, now - self.burst_s) + num_bytes / self.rate


@dataclass
class _Round:
    """Feedback of the receiver in one control round (about one round trip).

    Attributes:
        began_at: Time at which the round began, seconds.
        counts: Sent and lost datagrams.
        arrived_bytes: Estimated size of the received datagrams in bytes.
        seconds: Time in which these bytes were received, seconds.
        min_queue: Shortest queuing delay, seconds.
        max_queue: Longest queuing delay, seconds.
    """

    began_at: float
    counts: LossCounter = field(default_factory=LossCounter)
    arrived_bytes: float = 0.0
    seconds: float = 0.0
    min_queue: float = float("inf")
    max_queue: float = 0.0


@dataclass
class _RateReduction:
    """Temporary reduction of the sending rate, with which the sender measures the path.

    Attributes:
        kind: "drain" (empties the queue), "probe" (detects competing flows) or "test" (finds the cause of loss).
        until: Time at which the reduction ends, seconds.
        window: Congestion window before the reduction, bytes.
        rate: Sending rate during the reduction, bytes per second.
        before: For a test: sent and lost datagrams before the reduction.
        counts: Sent and lost datagrams during the reduction.
    """

    kind: str
    until: float
    window: float
    rate: float
    before: LossCounter = field(default_factory=LossCounter)
    counts: LossCounter = field(default_factory=LossCounter)


class RateControl:
    """Congestion control of a sender: chooses the sending rate from the receiver's feedback.

    The sending rate is CUBIC's congestion window (RFC 9438) divided by the round-trip time. Losses that seem
    random do not reduce the window. Losses that a full queue causes do reduce it. If the queuing delay is long, the
    rate is lowered for a short time to empty the queue. If the delay persists, another flow fills the queue. The delay
    then no longer lowers the rate (competitive mode).

    Args:
        start_rate: Maximum sending rate before the first feedback, bytes per second.
        max_rate: Maximum sending rate, bytes per second.
        bounded: True if QUIC limits the bytes in flight, so that sending may begin at the rate `start_rate`. False to
            begin with RFC 9438's initial window per round trip.
    """

    def __init__(self, start_rate: float = START_RATE, max_rate: float = MAX_RATE, *, bounded: bool = False) -> None:
        self.round_trip: float | None = None
        self._recent_round_trip = 0.0
        self.window = CubicWindow()
        self.competing = False
        self.queue, self.loss = QueueMeter(), LossMeter()
        self._start_rate, self._max_rate = min(start_rate, max_rate), max_rate
        self._timeout_start, self._has_timed_out = 0.0, False
        self._round: _Round | None = None
        self._reduction: _RateReduction | None = None
        self._delivery_rate = 0.0
        self._probe_at, self._probe_interval = 0.0, MIN_PROBE_INTERVAL_S
        self._competition_ended_at, self._competition_window = -math.inf, 0.0
        self._recovery_until = 0.0
        self._bounded = bounded
        self.rate = self._start_rate if bounded else min(self._start_rate, INITIAL_WINDOW / ASSUMED_ROUND_TRIP_S)

    def on_handshake_rtt(self, round_trip: float) -> None:
        """Sets the initial sending rate from the round-trip time of the handshake, seconds."""
        if self.round_trip is None and not self._bounded:
            self.rate = min(self._start_rate, INITIAL_WINDOW / max(round_trip, MIN_ROUND_S / 2))

    def on_send(self, now: float) -> None:
        """Restarts the feedback timeout.

        Called before a datagram is sent if the receiver has already reported all earlier datagrams.

        Args:
            now: Time, seconds.
        """
        self._timeout_start = now

    def on_feedback_timeout(self, now: float) -> None:
        """Halves the sending rate if the feedback timeout has expired at time `now`, seconds (RFC 8085, 3.1.1)."""
        wait = max(FEEDBACK_TIMEOUT_ROUNDS * (self.round_trip or ASSUMED_ROUND_TRIP_S), FEEDBACK_TIMEOUT_S)
        if now - self._timeout_start > wait:
            self._timeout_start, self._has_timed_out = now, True
            self.rate = max(self.rate / 2, MIN_RATE)

    def on_feedback(
        self,
        now: float,
        round_trip: float,
        transit: float,
        num_sent: int,
        num_arrived: int,
        bytes_arrived: float,
        seconds: float,
    ) -> None:
        """Updates the sending rate after a feedback report of the receiver.

        Each report names the latest datagram that the receiver has got. Let A be the datagram that the previous report
        names, and B the one that this report names. This report covers the datagrams that were sent after A, up to B.

        Args:
            now: Time, seconds.
            round_trip: Round-trip time of B, seconds.
            transit: One-way delay of B, seconds, plus an unknown constant clock offset.
            num_sent: Number of covered datagrams.
            num_arrived: Number of covered datagrams that were received.
            bytes_arrived: Estimated total size of the covered datagrams that were received, bytes.
            seconds: Time between the arrivals of A and B, seconds.
        """
        only_lost = self.round_trip is None and round_trip < FEEDBACK_TIMEOUT_ROUNDS * ASSUMED_ROUND_TRIP_S
        self.round_trip = round_trip if self.round_trip is None else 0.8 * self.round_trip + 0.2 * round_trip
        self._recent_round_trip = 0.5 * ((self._recent_round_trip or round_trip) + round_trip)
        if self._has_timed_out:
            # Only a handshake or the first report was lost: a congested path would show a long round-trip time.
            self.window.restart(float("inf") if only_lost else self.window.bytes / 2)
            self._reduction = self._round = None
        self._timeout_start, self._has_timed_out = now, False
        queue = self.queue.add(now, transit)
        current = self._round = self._round or _Round(now)
        lost = max(num_sent - num_arrived, 0)
        current.counts.add(LossCounter(num_sent, lost))
        current.arrived_bytes += bytes_arrived
        current.seconds += seconds
        current.min_queue, current.max_queue = min(current.min_queue, queue), max(current.max_queue, queue)
        if self.window.in_slow_start and not self._reduction and num_arrived and self._within_baseline(current.counts):
            # Scaled up, because baseline loss is no congestion.
            self.window.on_acked(bytes_arrived * num_sent / num_arrived)
        if current.min_queue > MAX_START_QUEUE_S and current.counts.sent >= 8:
            self.window.exit_slow_start()
        if now - current.began_at >= max(self.round_trip, MIN_ROUND_S) and current.counts.sent >= 2:
            self._round = _Round(now)
            current.counts.events = int(current.counts.lost > 0)
            self._end_round(current, now)
        self._set_rate()

    def _set_rate(self) -> None:
        assert self.round_trip is not None
        min_rate = MIN_WINDOW / max(self.round_trip, MIN_ROUND_S)
        if self._reduction:
            rate = max(self._reduction.rate, min_rate / 4)
        else:
            # A more smoothed round-trip time would lag behind the queue: after the window is reduced, the queue would
            # drain completely, and competing delay-based flows (BBR) would take the path for idle.
            rate = max(self.window.bytes / max(self._recent_round_trip, MIN_ROUND_S / 2), min_rate)
        self.rate = min(rate, self._max_rate)

    def _end_round(self, done: _Round, now: float) -> None:
        """Adapts congestion window or sending rate at the end of a control round (about one round trip).

        Args:
            done: Feedback of the control round that has ended.
            now: Time, seconds.
        """
        assert self.round_trip is not None
        length = max(now - done.began_at, 1e-3)
        arrived = done.arrived_bytes / max(done.seconds, 1e-3)
        self._delivery_rate = arrived if self._delivery_rate == 0.0 else 0.5 * (self._delivery_rate + arrived)
        high, low = self.queue.is_high(done.max_queue), self.queue.is_low(done.max_queue)
        broken = self.loss.is_circuit_broken(done.counts)
        congested = broken or (high and self.loss.is_congested(done.counts))
        before_test = self.loss.loss_rise(done.counts) if low and not self._is_testing else None
        if congested:
            self._reduce(done, now)
        elif self._reduction:
            self._update_reduction(self._reduction, done, now)
        elif before_test is not None:
            self._begin_reduction("test", now, 3 * self.round_trip, TEST_RATE_SHARE * self.rate, before_test)
        elif self.competing and now >= self._probe_at and not self.window.in_slow_start:
            self._begin_reduction(
                "probe", now, self._time_to_drain(PROBE_RATE_SHARE), PROBE_RATE_SHARE * self._capacity
            )
        elif not self.competing and done.min_queue > MAX_QUEUE_S:
            self._begin_reduction(
                "drain", now, 2 * self._time_to_drain(DRAIN_RATE_SHARE), DRAIN_RATE_SHARE * self._capacity
            )
        elif not self.window.in_slow_start and self._may_grow(done.counts, length):
            self.window.grow(now, length, max(self.round_trip, MIN_ROUND_S))

    def _may_grow(self, counts: LossCounter, length: float) -> bool:
        """True if the sender used so much of the allowed rate that the congestion window may grow (RFC 7661).

        Args:
            counts: Sent and lost datagrams of the control round.
            length: Duration of the control round, seconds.
        """
        return counts.sent * DATAGRAM > 0.5 * self.rate * length

    def _within_baseline(self, counts: LossCounter) -> bool:
        """True if the loss in a control round is at most the path's baseline loss."""
        baseline = self.loss.baseline or ASSUMED_BASELINE_LOSS
        return counts.lost <= BASELINE_TOLERANCE * baseline * counts.sent + self.loss.deviation(counts.sent)

    @property
    def _is_testing(self) -> bool:
        return self._reduction is not None and self._reduction.kind == "test"

    @property
    def _capacity(self) -> float:
        """Estimated capacity of the path, bytes per second."""
        return min(self._delivery_rate / (1.0 - self.loss.baseline), self.rate)

    def _time_to_drain(self, share: float) -> float:
        return (self.round_trip or 0.0) + 1.2 * self.queue.delay / (1.0 - share)

    def _begin_reduction(
        self, kind: str, now: float, seconds: float, rate: float, before: LossCounter | None = None
    ) -> None:
        self._reduction = _RateReduction(kind, now + seconds, self.window.bytes, rate, before or LossCounter())

    def _reduce(self, done: _Round, now: float) -> None:
        """Reduces the congestion window after congestion, at most once per round trip.

        Args:
            done: Feedback of the control round that has ended.
            now: Time, seconds.
        """
        # Further losses in the same round trip belong to the same congestion event.
        if done.began_at < self._recovery_until:
            return
        self.window.reduce()
        self._recovery_until = now + (self.round_trip or 0.0)
        if self._reduction:
            self._reduction.window = self.window.bytes

    def _update_reduction(self, reduction: _RateReduction, done: _Round, now: float) -> None:
        reduction.counts.add(done.counts)
        is_drained = done.min_queue < max(DRAINED_QUEUE_S, 0.1 * self.queue.max_delay)
        if reduction.kind == "test":
            if now >= reduction.until and self.loss.test_done(reduction.before, reduction.counts):
                self._reduction = None
                if self.loss.finish_test(reduction.before, reduction.counts, TEST_RATE_SHARE):
                    self.window.reduce()
                else:
                    self.window.undo()
        elif is_drained:
            self._reduction = None
            if reduction.kind == "drain":
                self.window.reduce(1.0)
                self._exit_drain(reduction.rate / DRAIN_RATE_SHARE, self.round_trip or 0.0)
            else:
                self.competing = False
                self._competition_ended_at, self._competition_window = now, reduction.window
                # The window before the probe would refill the queue at once.
                self._exit_drain(reduction.rate / PROBE_RATE_SHARE, self._recent_round_trip)
        elif now >= reduction.until:
            self._reduction = None
            self._enter_competitive_mode(now, reduction)

    def _exit_drain(self, capacity: float, round_trip: float) -> None:
        """Sets the window from the path's capacity after the queue was drained.

        Args:
            capacity: Estimated capacity of the path, bytes per second.
            round_trip: Round-trip time, seconds.
        """
        self.window.set(CRUISE_RATE_SHARE * capacity * max(round_trip, MIN_ROUND_S))

    def _enter_competitive_mode(self, now: float, reduction: _RateReduction) -> None:
        """Enters competitive mode, because another flow fills the queue. In this mode, only loss reduces the rate.

        Args:
            now: Time, seconds.
            reduction: The temporary rate reduction that has just ended.
        """
        window = reduction.window
        if reduction.kind == "drain":
            is_repeated = now - self._competition_ended_at < MIN_PROBE_INTERVAL_S
            if is_repeated:
                window = max(window, self._competition_window)
            self._probe_interval = (
                min(2 * self._probe_interval, MAX_PROBE_INTERVAL_S) if is_repeated else MIN_PROBE_INTERVAL_S
            )
        self.competing, self._competition_ended_at = True, -math.inf
        self._probe_at = now + self._probe_interval
        self.window.set(window)
