"""What the receiver's reports say about a path: how long its queue is, and which losses a full queue explains."""

import math
from collections import deque
from dataclasses import dataclass

BASE_WINDOW_S = 30.0
"""The shortest transit of this time is that of an empty queue."""
TOP_WINDOW_S = 10.0
STANDING = 3
"""Reports in a row that are late where a queue stands; fewer may be held up by something else (Wi-Fi, a busy host)."""
MIN_QUEUE_S = 0.004
"""Shorter queues are not told apart from noise."""
HIGH, LOW = 0.5, 0.3
"""Of the longest queue of late: above, losses may be the queue's; below, they are the path's own."""
MEMORY = 2000.0
"""Datagrams over which the path's own loss is averaged."""
MOST_USUAL = 0.3
"""No path loses more than this for other reasons than that it is full, as far as the control believes."""
HOPELESS = 0.45
"""A path that loses more than this is full or broken, whatever else is known of it."""
BATCH = 500
"""Datagrams over which loss is averaged to find out whether a path is broken."""
EVENTS = 3
"""Rounds with a loss that make a rise, and that a test must be long enough to show."""
ROUNDS = 16.0
"""Rounds over which it is averaged how much the loss varies."""
LOSS_STEP = 0.005
"""A rise of the loss by less is not looked into."""
SLACK = 1.25
"""Random loss varies: what was found usual may grow by this much without a new test."""


class Extremum:
    """The least value of late, of numbers with times.

    Args:
        window_s: How long a value counts.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._kept: deque[tuple[float, float]] = deque()

    def add(self, now: float, value: float) -> float:
        """Takes a value, gives the least one."""
        while self._kept and self._kept[-1][1] >= value:
            self._kept.pop()
        self._kept.append((now, value))
        while self._kept[0][0] < now - self._window_s:
            self._kept.popleft()
        return self._kept[0][1]


class QueueMeter:
    """How long datagrams wait, from their transit times by two clocks that need not agree."""

    def __init__(self) -> None:
        self._base, self._top = Extremum(BASE_WINDOW_S), Extremum(TOP_WINDOW_S)
        self._late: deque[float] = deque(maxlen=STANDING)
        self.queue = self.top = 0.0

    def add(self, now: float, transit: float) -> float:
        """Takes a transit time (seconds, any offset), gives the wait in the queue (seconds)."""
        self.queue = transit - self._base.add(now, transit)
        self._late.append(self.queue)
        self.top = -self._top.add(now, -min(self._late))
        return self.queue

    def high(self, queue: float) -> bool:
        """Whether a queue is so long that it may have been full."""
        return queue >= max(HIGH * self.top, MIN_QUEUE_S)

    def low(self, queue: float) -> bool:
        """Whether it is so short that it was not."""
        return queue <= max(LOW * self.top, MIN_QUEUE_S)


@dataclass
class Tally:
    """Datagrams sent and lost, and rounds in which some were: a burst is one event, however many it takes."""

    sent: int = 0
    lost: int = 0
    events: int = 0

    def add(self, other: "Tally") -> None:
        """Counts another one, too."""
        self.sent += other.sent
        self.lost += other.lost
        self.events += other.events

    @property
    def share(self) -> float:
        """The loss."""
        return self.lost / max(self.sent, 1)


class LossMeter:
    """Tells the loss that a path has at any rate from the loss of a full queue.

    Random loss does not know how long the queue is; a full queue loses when it is long. What a path loses is found out
    by sending less for a while: what does not go away is usual. Beyond that, losses while the queue is long are taken
    for congestion; a rise of the loss while it is short asks for a test.

    Attributes:
        usual: Share that the path loses at any rate.
    """

    def __init__(self) -> None:
        self.usual = 0.0
        self._most_usual = 0.0
        self._recent = 0.0
        self._excess = 0.0
        self._spread = 0.0
        self._late = Tally()

    def hopeless(self, seen: Tally) -> bool:
        """Takes a round; says whether so much is lost of late that no other cause than a full path is believed."""
        self._recent += min(seen.sent / BATCH, 1.0) * (seen.share - self._recent)
        return self._recent > HOPELESS

    def chance(self, sent: int) -> float:
        """Three standard deviations of how many are lost, bursts considered."""
        return 3.0 * math.sqrt(self._spread * sent)

    def congested(self, seen: Tally) -> bool:
        """Takes a round with a long queue; says whether more was lost than is usual."""
        self._excess = max(self._excess + seen.lost - SLACK * self.usual * seen.sent, 0.0)
        if self._excess <= 0.5 + self.chance(seen.sent):
            return False
        self._excess = 0.0
        return True

    def risen(self, seen: Tally) -> Tally | None:
        """Takes a round with a short queue; gives what was lost of late if that is more than usual and than chance."""
        off = seen.lost - seen.sent * self.usual
        self.usual = min(max(self.usual + off / MEMORY, 0.0), self._most_usual)
        if self.usual:  # else what varies may be congestion
            self._spread += (off * off / seen.sent - self._spread) / ROUNDS
        late = self._late
        late.add(seen)
        most = (self.usual + LOSS_STEP) * late.sent + self.chance(late.sent)
        risen = late.events >= EVENTS and late.lost > most
        if risen or late.sent > MEMORY:
            self._late = Tally()
        return late if risen else None

    def test_done(self, before: Tally, during: Tally) -> bool:
        """Whether a test was long enough to show what was there before."""
        return during.sent * before.events >= EVENTS * before.sent

    def judge(self, before: Tally, during: Tally, slower: float) -> bool:
        """Says whether the loss went away at a smaller rate; if not, it is usual from now on.

        Args:
            before: What was lost before.
            during: What was lost at the smaller rate.
            slower: The smaller rate over the one before.
        """
        self._late = Tally()
        if_full = max(1.0 - (1.0 - before.share) / slower, 0.0)
        if before.share > HOPELESS or during.share < 0.5 * (before.share + if_full):
            return True
        first, both = not self.usual, Tally()
        both.add(before)
        both.add(during)
        self.usual = min(both.share, MOST_USUAL)
        if first:
            self._spread = self.usual * both.lost / both.events
        self._most_usual = min(SLACK * self.usual + LOSS_STEP, MOST_USUAL)
        return False
