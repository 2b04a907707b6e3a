"""How fast to send: a rate control that yields to queues and to who shares them, not to random loss."""

from dataclasses import dataclass, field

from splatwire.transport.cubic import INITIAL, LEAST, CubicWindow
from splatwire.transport.path import SLACK, LossMeter, QueueMeter, Tally

START_RATE = 1.0e6
"""Most bytes per second before the first feedback: 8 Mbit/s."""
MAX_RATE = 1.25e8
ASSUMED_ROUND_TRIP_S = 0.1
"""Where nothing has been measured."""
QUEUE_S, DRAINED_S = 0.025, 0.008
"""Standing queue that is tolerated where nobody else fills it, and what is left of it after draining, seconds."""
START_QUEUE_S = 0.01
"""A queue at which slow start ends (RFC 9406)."""
START_LOSS = 0.2
"""Loss that is taken for usual while slow start knows nothing of the path: a full one soon loses more."""
DRAIN_SHARE, FULL_SHARE = 0.75, 0.9
"""Of what the path carries: sent while its queue drains, and once it has."""
PROBE_SHARE = 0.5
"""Sent while a competing sender looks whether it is alone."""
TEST_SHARE = 0.6
"""Sent while it is found out whether loss depends on the rate."""
PROBE_EVERY_S, PROBE_EVERY_MOST_S = 15.0, 80.0
"""Not in step with the 10 s for which BBR believes an empty queue: each probe that it meets costs it its share."""
ROUND_S = 0.02
"""Receivers report no more often."""
SILENCE_S, SILENT_ROUNDS = 0.2, 4.0
"""A time without news after which the rate is halved, and again."""
DATAGRAM = 1200
SLOWEST = 2.4e3
"""Bytes per second where no news comes."""


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


@dataclass
class _Round:
    """What was reported within about a round trip."""

    began: float
    seen: Tally = field(default_factory=Tally)
    arrived_bytes: float = 0.0
    seconds: float = 0.0
    least_queue: float = float("inf")
    most_queue: float = 0.0


@dataclass
class _Pause:
    """A time at a smaller rate, after which something is known.

    Attributes:
        kind: "drain" (the queue is too long), "probe" (is anybody else here?), "test" (does loss depend on the rate?).
        until: When it ends.
        window: The window before it.
        rate: Bytes per second within.
        before: Of a test: what was lost before it.
        seen: What was lost within.
    """

    kind: str
    until: float
    window: float
    rate: float
    before: Tally = field(default_factory=Tally)
    seen: Tally = field(default_factory=Tally)


class RateControl:
    """Chooses the rate from feedback.

    The window is CUBIC's (RFC 9438), sent evenly over the latest round trip: over one that lags behind the queue, a
    smaller window would drain the queue whole, from which flows that look at delay (BBR) take it that they are alone
    and lose. Which losses are congestion is decided by
    `LossMeter`: those beyond the path's usual loss while the queue is long. Loss with a short queue is put to a test:
    it is congestion if it goes away at a smaller rate. While nobody else fills the queue, one of `QUEUE_S` is drained.
    A queue that does not drain belongs to somebody who competes, and only loss counts then, until a probe finds the
    queue empty again. Without news the rate halves again and again.

    Args:
        start: Largest rate before the first feedback, bytes per second.
        most: Largest rate, bytes per second.
        bounded: Whether something else bounds what is under way before the first feedback (QUIC).
    """

    def __init__(self, start: float = START_RATE, most: float = MAX_RATE, *, bounded: bool = False) -> None:
        self.round_trip: float | None = None
        self._latest = 0.0
        self.window = CubicWindow()
        self.competing = False
        self.queue, self.loss = QueueMeter(), LossMeter()
        self._start, self._most = min(start, most), most
        self._quiet_since, self._quiet = 0.0, False
        self._round: _Round | None = None
        self._pause: _Pause | None = None
        self._carried = 0.0
        self._probe_at, self._probe_every = 0.0, PROBE_EVERY_S
        self._left: tuple[float, float] | None = None
        self._hold_until = 0.0
        self._bounded = bounded
        self.rate = self._start if bounded else min(self._start, INITIAL / ASSUMED_ROUND_TRIP_S)

    def greeted(self, round_trip: float) -> None:
        """Takes the time from the answer to a request to the first report."""
        if self.round_trip is None and not self._bounded:
            self.rate = min(self._start, INITIAL / max(round_trip, ROUND_S / 2))

    def expect(self, now: float) -> None:
        """Notes that something is under way from now on."""
        self._quiet_since = now

    def silent(self, now: float) -> None:
        """Halves the rate where it is time that news of what is under way came (RFC 8085, section 3.1.1)."""
        wait = max(SILENT_ROUNDS * (self.round_trip or ASSUMED_ROUND_TRIP_S), SILENCE_S)
        if now - self._quiet_since > wait:
            self._quiet_since, self._quiet = now, True
            self.rate = max(self.rate / 2, SLOWEST)

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
        """Takes one feedback.

        Args:
            now: Time, seconds.
            round_trip: Of the latest datagram that arrived, seconds.
            transit: Of the same, by the receiver's clock and ours: seconds, with any offset.
            num_sent: Datagrams sent between those that the last and this feedback name.
            num_arrived: How many of them arrived.
            bytes_arrived: About how many bytes that was.
            seconds: Time between the arrivals.
        """
        only_lost = self.round_trip is None and round_trip < SILENT_ROUNDS * ASSUMED_ROUND_TRIP_S
        self.round_trip = round_trip if self.round_trip is None else 0.8 * self.round_trip + 0.2 * round_trip
        self._latest = 0.5 * ((self._latest or round_trip) + round_trip)
        if self._quiet:
            # a greeting or the first report was lost: of a full path the round trip itself would be long
            self.window.restart(float("inf") if only_lost else self.window.bytes / 2)
            self._pause = self._round = None
        self._quiet_since, self._quiet = now, False
        queue = self.queue.add(now, transit)
        current = self._round = self._round or _Round(now)
        lost = max(num_sent - num_arrived, 0)
        current.seen.add(Tally(num_sent, lost))
        current.arrived_bytes += bytes_arrived
        current.seconds += seconds
        current.least_queue, current.most_queue = min(current.least_queue, queue), max(current.most_queue, queue)
        if self.window.starting and not self._pause and num_arrived and self._steady(current.seen):
            self.window.acknowledged(bytes_arrived * num_sent / num_arrived)  # what is lost as ever is no congestion
        if current.least_queue > START_QUEUE_S and current.seen.sent >= 8:
            self.window.stop_starting()
        if now - current.began >= max(self.round_trip, ROUND_S) and current.seen.sent >= 2:
            self._round = _Round(now)
            current.seen.events = int(current.seen.lost > 0)
            self._close(current, now)
        self._set_rate()

    def _set_rate(self) -> None:
        assert self.round_trip is not None
        least = LEAST / max(self.round_trip, ROUND_S)
        if self._pause:
            wanted = max(self._pause.rate, least / 4)
        else:
            wanted = max(self.window.bytes / max(self._latest, ROUND_S / 2), least)
        self.rate = min(wanted, self._most)

    def _close(self, done: _Round, now: float) -> None:
        """Decides after a round."""
        assert self.round_trip is not None
        length = max(now - done.began, 1e-3)
        arrived = done.arrived_bytes / max(done.seconds, 1e-3)
        self._carried = arrived if self._carried == 0.0 else 0.5 * (self._carried + arrived)
        high, low = self.queue.high(done.most_queue), self.queue.low(done.most_queue)
        hopeless = self.loss.hopeless(done.seen)
        congested = hopeless or (high and self.loss.congested(done.seen))
        risen = self.loss.risen(done.seen) if low and not self._testing else None
        if congested:
            self._reduce(done, now)
        elif self._pause:
            self._within_pause(self._pause, done, now)
        elif risen is not None:
            self._begin("test", now, 3 * self.round_trip, TEST_SHARE * self.rate, risen)
        elif self.competing and now >= self._probe_at and not self.window.starting:
            self._begin("probe", now, self._time_to_drain(PROBE_SHARE), PROBE_SHARE * self._capacity)
        elif not self.competing and done.least_queue > QUEUE_S:
            self._begin("drain", now, 2 * self._time_to_drain(DRAIN_SHARE), DRAIN_SHARE * self._capacity)
        elif not self.window.starting and self._may_grow(done.seen, length):
            self.window.grow(now, length, max(self.round_trip, ROUND_S))

    def _may_grow(self, seen: Tally, length: float) -> bool:
        """Whether about as much was sent as was allowed (RFC 7661)."""
        return seen.sent * DATAGRAM > 0.5 * self.rate * length

    def _steady(self, seen: Tally) -> bool:
        """Whether no more was lost than is usual, or can be where nothing is known yet: slow start goes on."""
        usual = self.loss.usual or START_LOSS
        return seen.lost <= SLACK * usual * seen.sent + self.loss.chance(seen.sent)

    @property
    def _testing(self) -> bool:
        return self._pause is not None and self._pause.kind == "test"

    @property
    def _capacity(self) -> float:
        """Bytes per second to send so that what gets through is what did."""
        return min(self._carried / (1.0 - self.loss.usual), self.rate)

    def _time_to_drain(self, share: float) -> float:
        return (self.round_trip or 0.0) + 1.2 * self.queue.queue / (1.0 - share)

    def _begin(self, kind: str, now: float, seconds: float, rate: float, before: Tally | None = None) -> None:
        self._pause = _Pause(kind, now + seconds, self.window.bytes, rate, before or Tally())

    def _reduce(self, done: _Round, now: float) -> None:
        """Answers a loss that is congestion, once a round trip: what was lost before the answer came counts with it."""
        if done.began < self._hold_until:
            return
        self.window.reduce()
        self._hold_until = now + (self.round_trip or 0.0)
        if self._pause:
            self._pause.window = self.window.bytes

    def _within_pause(self, pause: _Pause, done: _Round, now: float) -> None:
        pause.seen.add(done.seen)
        drained = done.least_queue < max(DRAINED_S, 0.1 * self.queue.top)
        if pause.kind == "test":
            if now >= pause.until and self.loss.test_done(pause.before, pause.seen):
                self._pause = None
                if self.loss.judge(pause.before, pause.seen, TEST_SHARE):
                    self.window.reduce()
                else:
                    self.window.undo()
        elif drained:
            self._pause = None
            if pause.kind == "drain":
                self.window.reduce(1.0)
                self._fill(pause.rate / DRAIN_SHARE, self.round_trip or 0.0)
            else:
                self.competing, self._left = False, (now, pause.window)
                self._fill(pause.rate / PROBE_SHARE, self._latest)  # the window of before would fill it at once
        elif now >= pause.until:
            self._pause = None
            self._compete(now, pause)

    def _fill(self, capacity: float, round_trip: float) -> None:
        """Goes on beside an empty queue with about what the path carries."""
        self.window.set(FULL_SHARE * capacity * max(round_trip, ROUND_S))

    def _compete(self, now: float, pause: _Pause) -> None:
        """Somebody else fills the queue: from now on only loss counts."""
        window = pause.window
        if pause.kind == "drain":
            again = self._left is not None and now - self._left[0] < PROBE_EVERY_S
            if again and self._left is not None:
                window = max(window, self._left[1])
            self._probe_every = min(2 * self._probe_every, PROBE_EVERY_MOST_S) if again else PROBE_EVERY_S
        self.competing, self._left = True, None
        self._probe_at = now + self._probe_every
        self.window.set(window)
