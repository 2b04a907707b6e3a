"""CUBIC's window (RFC 9438), by rounds: what a TCP sender in our place would have under way."""

SEGMENT = 1500.0
"""Bytes of a TCP segment with its headers: growth is counted in these, whatever the size of our datagrams."""
INITIAL = 10 * SEGMENT
"""RFC 6928."""
LEAST = 2 * SEGMENT
C, BETA = 0.4, 0.7
RENO_FRIENDLY = 3 * (1 - BETA) / (1 + BETA)


class CubicWindow:
    """The window, bytes. It reacts to what it is told is congestion, not to loss.

    Attributes:
        bytes: The window.
        threshold: Below, the window doubles each round.
    """

    def __init__(self) -> None:
        self.bytes = INITIAL
        self.threshold = float("inf")
        self._most = 0.0
        self._since: float | None = None
        self._origin = 0.0
        self._k = 0.0
        self._reno = 0.0
        self._undo: tuple[float, float] | None = None

    @property
    def starting(self) -> bool:
        """Whether it is in slow start."""
        return self.bytes < self.threshold

    def acknowledged(self, num_bytes: float) -> None:
        """Slow start: grows by what arrived (RFC 5681, 3.1), which doubles it in a round trip."""
        self.bytes = min(self.bytes + num_bytes, max(self.threshold, LEAST))

    def grow(self, now: float, seconds: float, round_trip: float) -> None:
        """Grows by some seconds without congestion, after slow start.

        Args:
            now: Time, seconds.
            seconds: Time since it grew last.
            round_trip: Smoothed, seconds.
        """
        rounds = seconds / round_trip
        if self._since is None:
            self._since, self._reno = now - seconds, self.bytes
            self._most = max(self._most, self.bytes)
            self._k = ((self._most - self.bytes) / SEGMENT / C) ** (1 / 3)
        since = now - self._since
        target = self._most + SEGMENT * C * (since - self._k) ** 3
        self._reno += SEGMENT * rounds * (1.0 if self._reno >= self._most else RENO_FRIENDLY)
        self.bytes = min(max(self.bytes, target, self._reno), 1.5**rounds * self.bytes)

    def reduce(self, share: float = BETA, in_use: float = float("inf")) -> None:
        """Congestion: keeps a share of what was in use."""
        used = min(self.bytes, in_use)
        self._undo = self.bytes, self.threshold
        self._most = used * (1 + BETA) / 2 if used < self._most else used
        self.bytes = self.threshold = max(share * used, LEAST)
        self._since = None

    def stop_starting(self) -> None:
        """Ends slow start where it is."""
        self.threshold = min(self.threshold, self.bytes)

    def undo(self) -> None:
        """Takes the last reduction back: what it answered was not congestion."""
        if self._undo:
            self.bytes, self.threshold = max(self.bytes, self._undo[0]), max(self.threshold, self._undo[1])
            self._undo, self._since = None, None

    def set(self, window: float) -> None:
        """Goes on from another window, no longer in slow start."""
        self.bytes = self.threshold = max(window, LEAST)
        self._since = None

    def restart(self, threshold: float) -> None:
        """Slow start after a time without news, from half of what was and at most an initial window.

        Args:
            threshold: Where slow start ends.
        """
        self.threshold = max(threshold, LEAST)
        self.bytes, self._since = max(min(INITIAL, self.bytes / 2), LEAST), None
