"""Pacing and rate control of a sender, which reacts to queuing delay and congestion, not to random loss."""

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
"""Sending rate during a test, as a share of the rate before the test. It shows if the loss depends on the rate."""
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
        claimed: True while datagrams wait for this pacer. HTTP responses with the same pacer then pause, so that both
            get a share of the rate.
    """

    rate: float
    burst_s: float = 0.004
    claimed: bool = False
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
        seen: Sent and lost datagrams.
        arrived_bytes: Estimated size of the received datagrams in bytes.
        seconds: Time in which these bytes were received, seconds.
        min_queue: Shortest queuing delay, seconds.
        max_queue: Longest queuing delay, seconds.
    """

    began_at: float
    seen: LossCounter = field(default_factory=LossCounter)
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
        seen: Sent and lost datagrams during the reduction.
    """

    kind: str
    until: float
    window: float
    rate: float
    before: LossCounter = field(default_factory=LossCounter)
    seen: LossCounter = field(default_factory=LossCounter)


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
        self._latest = 0.0
        self.window = CubicWindow()
        self.competing = False
        self.queue, self.loss = QueueMeter(), LossMeter()
        self._start_rate, self._max_rate = min(start_rate, max_rate), max_rate
        self._quiet_since, self._quiet = 0.0, False
        self._round: _Round | None = None
        self._pause: _RateReduction | None = None
        self._carried = 0.0
        self._probe_at, self._probe_interval = 0.0, MIN_PROBE_INTERVAL_S
        self._left: tuple[float, float] | None = None
        self._hold_until = 0.0
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
        self._quiet_since = now

    def on_feedback_timeout(self, now: float) -> None:
        """Halves the sending rate if the feedback timeout has expired at time `now`, seconds (RFC 8085, 3.1.1)."""
        wait = max(FEEDBACK_TIMEOUT_ROUNDS * (self.round_trip or ASSUMED_ROUND_TRIP_S), FEEDBACK_TIMEOUT_S)
        if now - self._quiet_since > wait:
            self._quiet_since, self._quiet = now, True
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
        self._latest = 0.5 * ((self._latest or round_trip) + round_trip)
        if self._quiet:
            # Only a handshake or the first report was lost: a congested path would show a long round-trip time.
            self.window.restart(float("inf") if only_lost else self.window.bytes / 2)
            self._pause = self._round = None
        self._quiet_since, self._quiet = now, False
        queue = self.queue.add(now, transit)
        current = self._round = self._round or _Round(now)
        lost = max(num_sent - num_arrived, 0)
        current.seen.add(LossCounter(num_sent, lost))
        current.arrived_bytes += bytes_arrived
        current.seconds += seconds
        current.min_queue, current.max_queue = min(current.min_queue, queue), max(current.max_queue, queue)
        if self.window.in_slow_start and not self._pause and num_arrived and self._within_baseline(current.seen):
            # Scaled up, because baseline loss is no congestion.
            self.window.on_acked(bytes_arrived * num_sent / num_arrived)
        if current.min_queue > MAX_START_QUEUE_S and current.seen.sent >= 8:
            self.window.exit_slow_start()
        if now - current.began_at >= max(self.round_trip, MIN_ROUND_S) and current.seen.sent >= 2:
            self._round = _Round(now)
            current.seen.events = int(current.seen.lost > 0)
            self._end_round(current, now)
        self._set_rate()

    def _set_rate(self) -> None:
        assert self.round_trip is not None
        least = MIN_WINDOW / max(self.round_trip, MIN_ROUND_S)
        if self._pause:
            wanted = max(self._pause.rate, least / 4)
        else:
            # A more smoothed round-trip time would lag behind the queue: after the window is reduced, the queue would
            # drain completely, and competing delay-based flows (BBR) would take the path for idle.
            wanted = max(self.window.bytes / max(self._latest, MIN_ROUND_S / 2), least)
        self.rate = min(wanted, self._max_rate)

    def _end_round(self, done: _Round, now: float) -> None:
        """Adapts congestion window or sending rate at the end of a control round (about one round trip).

        Args:
            done: Feedback of the control round that has ended.
            now: Time, seconds.
        """
        assert self.round_trip is not None
        length = max(now - done.began_at, 1e-3)
        arrived = done.arrived_bytes / max(done.seconds, 1e-3)
        self._carried = arrived if self._carried == 0.0 else 0.5 * (self._carried + arrived)
        high, low = self.queue.is_high(done.max_queue), self.queue.is_low(done.max_queue)
        broken = self.loss.is_circuit_broken(done.seen)
        congested = broken or (high and self.loss.is_congested(done.seen))
        rise = self.loss.loss_rise(done.seen) if low and not self._testing else None
        if congested:
            self._reduce(done, now)
        elif self._pause:
            self._within_pause(self._pause, done, now)
        elif rise is not None:
            self._begin("test", now, 3 * self.round_trip, TEST_RATE_SHARE * self.rate, rise)
        elif self.competing and now >= self._probe_at and not self.window.in_slow_start:
            self._begin("probe", now, self._time_to_drain(PROBE_RATE_SHARE), PROBE_RATE_SHARE * self._capacity)
        elif not self.competing and done.min_queue > MAX_QUEUE_S:
            self._begin("drain", now, 2 * self._time_to_drain(DRAIN_RATE_SHARE), DRAIN_RATE_SHARE * self._capacity)
        elif not self.window.in_slow_start and self._may_grow(done.seen, length):
            self.window.grow(now, length, max(self.round_trip, MIN_ROUND_S))

    def _may_grow(self, seen: LossCounter, length: float) -> bool:
        """True if the sender used so much of the allowed rate that the congestion window may grow (RFC 7661).

        Args:
            seen: Sent and lost datagrams of the control round.
            length: Duration of the control round, seconds.
        """
        return seen.sent * DATAGRAM > 0.5 * self.rate * length

    def _within_baseline(self, seen: LossCounter) -> bool:
        """True if the loss in a control round is at most the path's baseline loss."""
        baseline = self.loss.baseline or ASSUMED_BASELINE_LOSS
        return seen.lost <= BASELINE_TOLERANCE * baseline * seen.sent + self.loss.deviation(seen.sent)

    @property
    def _testing(self) -> bool:
        return self._pause is not None and self._pause.kind == "test"

    @property
    def _capacity(self) -> float:
        """Estimated capacity of the path, bytes per second."""
        return min(self._carried / (1.0 - self.loss.baseline), self.rate)

    def _time_to_drain(self, share: float) -> float:
        return (self.round_trip or 0.0) + 1.2 * self.queue.queue / (1.0 - share)

    def _begin(self, kind: str, now: float, seconds: float, rate: float, before: LossCounter | None = None) -> None:
        self._pause = _RateReduction(kind, now + seconds, self.window.bytes, rate, before or LossCounter())

    def _reduce(self, done: _Round, now: float) -> None:
        """Reduces the congestion window after congestion, at most once per round trip.

        Args:
            done: Feedback of the control round that has ended.
            now: Time, seconds.
        """
        # Further losses in the same round trip belong to the same congestion event.
        if done.began_at < self._hold_until:
            return
        self.window.reduce()
        self._hold_until = now + (self.round_trip or 0.0)
        if self._pause:
            self._pause.window = self.window.bytes

    def _within_pause(self, pause: _RateReduction, done: _Round, now: float) -> None:
        pause.seen.add(done.seen)
        drained = done.min_queue < max(DRAINED_QUEUE_S, 0.1 * self.queue.top)
        if pause.kind == "test":
            if now >= pause.until and self.loss.test_done(pause.before, pause.seen):
                self._pause = None
                if self.loss.finish_test(pause.before, pause.seen, TEST_RATE_SHARE):
                    self.window.reduce()
                else:
                    self.window.undo()
        elif drained:
            self._pause = None
            if pause.kind == "drain":
                self.window.reduce(1.0)
                self._exit_drain(pause.rate / DRAIN_RATE_SHARE, self.round_trip or 0.0)
            else:
                self.competing, self._left = False, (now, pause.window)
                # The window before the probe would refill the queue at once.
                self._exit_drain(pause.rate / PROBE_RATE_SHARE, self._latest)
        elif now >= pause.until:
            self._pause = None
            self._enter_competitive_mode(now, pause)

    def _exit_drain(self, capacity: float, round_trip: float) -> None:
        """Sets the window from the path's capacity after the queue was drained.

        Args:
            capacity: Estimated capacity of the path, bytes per second.
            round_trip: Round-trip time, seconds.
        """
        self.window.set(CRUISE_RATE_SHARE * capacity * max(round_trip, MIN_ROUND_S))

    def _enter_competitive_mode(self, now: float, pause: _RateReduction) -> None:
        """Enters competitive mode, because another flow fills the queue. In this mode, only loss reduces the rate.

        Args:
            now: Time, seconds.
            pause: The temporary rate reduction that has just ended.
        """
        window = pause.window
        if pause.kind == "drain":
            again = self._left is not None and now - self._left[0] < MIN_PROBE_INTERVAL_S
            if again and self._left is not None:
                window = max(window, self._left[1])
            self._probe_interval = (
                min(2 * self._probe_interval, MAX_PROBE_INTERVAL_S) if again else MIN_PROBE_INTERVAL_S
            )
        self.competing, self._left = True, None
        self._probe_at = now + self._probe_interval
        self.window.set(window)
