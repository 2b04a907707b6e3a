"""Models of TCP senders: CUBIC (RFC 9438) and one similar to BBR (draft-cardwell-iccrg-bbr-congestion-control-00)."""

from collections import deque
from dataclasses import dataclass

from transport.bottleneck import Network, count

SEGMENT, HEADERS = 1448, 52
INITIAL_WINDOW = 10.0
"""SourceBlocks (RFC 6928)."""
REORDERING = 3
"""A segment is lost once one sent this many later is acknowledged (RFC 6675), or when it is late (RFC 8985)."""
MIN_TIMEOUT_S = 0.2


@dataclass
class _Sent:
    number: int
    at: float
    delivered: int
    delivered_at: float
    limited: bool = False


class Tcp:
    """Common part of both models: each segment is acknowledged, and losses are detected as by SACK.

    The sender always has data. Windows are counted in segments.
    """

    def __init__(self, network: Network, begin: float = 0.0) -> None:
        self.network = network
        self.arrived: list[int] = []
        self.window = INITIAL_WINDOW
        self.round_trip: float | None = None
        self.least = float("inf")
        self.delivered = 0
        self.delivered_at = begin
        self._variation = 0.0
        self._number = 0
        self._out: dict[int, _Sent] = {}
        self._heard_at = begin
        self._backoff = 1
        self._probed = False
        network.at(begin, self._begin)

    def _begin(self) -> None:
        self._heard_at = self.delivered_at = self.network.now
        self._watch()
        self.fill()

    @property
    def in_flight(self) -> int:
        return len(self._out)

    def fill(self) -> None:
        """Sends all segments that the window allows."""
        while self.in_flight < int(self.window):
            self.send_one()

    def send_one(self) -> None:
        number, now = self._number, self.network.now
        self._number += 1
        self._out[number] = _Sent(number, now, self.delivered, self.delivered_at)
        self.network.send(SEGMENT + HEADERS, lambda: self._received(number))

    def _received(self, number: int) -> None:
        count(self.arrived, self.network.now, SEGMENT + HEADERS)
        self.network.back(lambda: self._acknowledged(number))

    def _acknowledged(self, number: int) -> None:
        sent = self._out.pop(number, None)
        if sent is None:
            return
        now = self.network.now
        self._heard_at, self._backoff, self._probed = now, 1, False
        sample = now - sent.at
        if self.round_trip is None:
            self.round_trip, self._variation = sample, sample / 2
        else:
            self._variation += 0.25 * (abs(sample - self.round_trip) - self._variation)
            self.round_trip += 0.125 * (sample - self.round_trip)
        self.delivered += 1
        self.delivered_at = now
        gone = []
        for other, candidate in self._out.items():  # in the order of sending
            late = other < number and now - candidate.at > 1.25 * self.round_trip
            if other > number - REORDERING and not late:
                break
            gone.append(other)
        lost = [self._out.pop(other) for other in gone]
        self.on_ack(sent, sample, len(lost), lost[-1].number if lost else -1)
        self.fill()

    def _watch(self) -> None:
        """The tail loss probe after two round trips (RFC 8985), then the retransmission timeout (RFC 6298)."""
        silence = self.network.now - self._heard_at
        if self._out and self.round_trip and not self._probed and silence >= 2 * self.round_trip:
            self._probed = True
            self.send_one()
        wait = max((self.round_trip or 1.0) + 4 * self._variation, MIN_TIMEOUT_S) * self._backoff
        if self._out and silence >= wait:
            self._out.clear()
            self._heard_at, self._backoff = self.network.now, min(2 * self._backoff, 64)
            self.on_timeout()
            self.fill()
        self.network.at(self.network.now + 0.01, self._watch)

    def on_ack(self, sent: _Sent, sample: float, lost: int, last_lost: int) -> None:
        raise NotImplementedError

    def on_timeout(self) -> None:
        raise NotImplementedError


class Cubic(Tcp):
    """CUBIC: RFC 9438, with its fast convergence and Reno-friendly region; slow start ends as HyStart++ (RFC 9406)."""

    C, BETA = 0.4, 0.7

    def __init__(self, network: Network, begin: float = 0.0) -> None:
        super().__init__(network, begin)
        self._threshold = float("inf")
        self._most = 0.0
        self._epoch: float | None = None
        self._k = self._estimate = 0.0
        self._recovery = -1
        self._round_end, self._round_least, self._last_least, self._samples = 0, float("inf"), float("inf"), 0

    def on_ack(self, sent: _Sent, sample: float, lost: int, last_lost: int) -> None:
        self.least = min(self.least, sample)
        if lost:
            if last_lost >= self._recovery:
                self._reduce()
            return
        if self.window < self._threshold:
            self.window += 1
            self._hystart(sent.number, sample)
        else:
            self._grow()

    def on_timeout(self) -> None:
        self._reduce()
        self.window = 1.0

    def _reduce(self) -> None:
        self._recovery = self._number
        flight = min(self.window, self.in_flight + 1.0)
        self._most = flight * (1 + self.BETA) / 2 if flight < self._most else flight
        self.window = self._threshold = max(flight * self.BETA, 2.0)
        self._epoch = None

    def _grow(self) -> None:
        now, round_trip = self.network.now, self.round_trip or 0.1
        if self._epoch is None:
            self._epoch = now
            self._estimate = self.window
            self._most = max(self._most, self.window)
            self._k = ((self._most - self.window) / self.C) ** (1 / 3)
        t = now - self._epoch
        target = self.C * (t + round_trip - self._k) ** 3 + self._most
        target = min(max(target, self.window), 1.5 * self.window)
        alpha = 1.0 if self._estimate >= self._most else 3 * (1 - self.BETA) / (1 + self.BETA)
        self._estimate += alpha / self.window
        if self.C * (t - self._k) ** 3 + self._most < self._estimate:
            self.window = max(self.window, self._estimate)
        else:
            self.window += (target - self.window) / self.window

    def _hystart(self, number: int, sample: float) -> None:
        if number >= self._round_end:
            self._last_least, self._round_least, self._samples = self._round_least, float("inf"), 0
            self._round_end = self._number
        self._round_least = min(self._round_least, sample)
        self._samples += 1
        slack = min(max(self._last_least / 8, 0.004), 0.016)
        if self._samples >= 8 and self._last_least < 1e9 and self._round_least >= self._last_least + slack:
            self._threshold = self.window


class Bbr(Tcp):
    """A sender similar to BBR: it sends at the largest delivery rate, regardless of loss, and probes for more."""

    HIGH = 2.885
    CYCLE = (1.25, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    ROUNDS, MIN_S, PROBE_S = 10, 10.0, 0.2

    def __init__(self, network: Network, begin: float = 0.0) -> None:
        super().__init__(network, begin)
        self._state = "startup"
        self._rates: deque[tuple[int, float]] = deque()
        self._round, self._round_end = 0, 0
        self._full, self._full_rounds = 0.0, 0
        self._pacing, self._gain = self.HIGH, self.HIGH
        self._least_at = begin
        self._phase, self._phase_at = 0, begin
        self._probe_until: float | None = None
        self._send_at = begin
        self._planned = False

    @property
    def _rate(self) -> float:
        """SourceBlocks per second."""
        return max((rate for _, rate in self._rates), default=INITIAL_WINDOW / (self.round_trip or 0.001))

    @property
    def _product(self) -> float:
        return self._rate * self.least if self.least < 1e9 else INITIAL_WINDOW

    def fill(self) -> None:
        if self._planned or self.in_flight >= self._allowed():
            return
        if self.network.now >= self._send_at - 1e-9:
            self.send_one()
            self._send_at = max(self._send_at, self.network.now) + 1 / (self._pacing * self._rate)
        self._planned = True
        self.network.at(self._send_at, self._again)

    def _again(self) -> None:
        self._planned = False
        self.fill()

    def _allowed(self) -> float:
        if self._state == "probe round trip":
            return 4.0
        if not self._rates:
            return INITIAL_WINDOW
        return max(self._gain * self._product, 4.0)

    def on_ack(self, sent: _Sent, sample: float, lost: int, last_lost: int) -> None:
        now = self.network.now
        if sent.number >= self._round_end:
            self._round, self._round_end = self._round + 1, self._number
            new_round = True
        else:
            new_round = False
        took = max(now - sent.delivered_at, 1e-6)
        rate = (self.delivered - sent.delivered) / took
        while self._rates and self._rates[-1][1] <= rate:
            self._rates.pop()
        self._rates.append((self._round, rate))
        while self._rates[0][0] < self._round - self.ROUNDS:
            self._rates.popleft()
        expired = now > self._least_at + self.MIN_S
        if sample <= self.least or expired:
            self.least, self._least_at = sample, now
        self._change(now, new_round, expired)

    def _change(self, now: float, new_round: bool, expired: bool) -> None:
        if self._state == "startup" and new_round:
            if self._rate >= 1.25 * self._full:
                self._full, self._full_rounds = self._rate, 0
            else:
                self._full_rounds += 1
            if self._full_rounds >= 3:
                self._state, self._pacing = "drain", 1 / self.HIGH
        if self._state == "drain" and self.in_flight <= self._product:
            self._cruise(now)
        if self._state == "cruise":
            due = now - self._phase_at > self.least
            if self.CYCLE[self._phase] == 1.25:
                due = due and (self.in_flight >= 1.25 * self._product or now - self._phase_at > 2 * self.least)
            elif self.CYCLE[self._phase] == 0.75:
                due = due or self.in_flight <= self._product
            if due:
                self._phase, self._phase_at = (self._phase + 1) % 8, now
                self._pacing = self.CYCLE[self._phase]
        if expired and self._state != "probe round trip":
            self._state, self._pacing, self._probe_until = "probe round trip", 1.0, None
        if self._state == "probe round trip":
            if self._probe_until is None:
                if self.in_flight <= 4:
                    self._probe_until = now + max(self.PROBE_S, self.least)
            elif now > self._probe_until:
                self._least_at = now
                if self._full_rounds >= 3:
                    self._cruise(now)
                else:
                    self._state, self._pacing, self._gain = "startup", self.HIGH, self.HIGH

    def _cruise(self, now: float) -> None:
        self._state, self._gain, self._phase, self._phase_at = "cruise", 2.0, 2, now
        self._pacing = 1.0

    def on_timeout(self) -> None:
        self._rates.clear()
