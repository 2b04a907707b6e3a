"""CUBIC congestion window (RFC 9438), updated once per round trip."""

SEGMENT = 1500.0
"""Size of a TCP segment with headers in bytes, in which CUBIC's window growth is defined. The size of splatwire's
datagrams does not affect the growth.
"""
INITIAL_WINDOW = 10 * SEGMENT
"""Initial window in bytes (RFC 6928)."""
MIN_WINDOW = 2 * SEGMENT
C, BETA = 0.4, 0.7
"""Constants of CUBIC: growth, segments per cubed second; and factor on the window after congestion."""
RENO_FRIENDLY = 3 * (1 - BETA) / (1 + BETA)


class CubicWindow:
    """CUBIC congestion window (RFC 9438).

    Attributes:
        bytes: Congestion window, bytes.
        threshold: Slow-start threshold, bytes.
    """

    def __init__(self) -> None:
        self.bytes = INITIAL_WINDOW
        self.threshold = float("inf")
        self._max_window = 0.0
        self._epoch_start: float | None = None
        self._k = 0.0
        self._reno_window = 0.0
        self._before_reduction: tuple[float, float] | None = None

    @property
    def in_slow_start(self) -> bool:
        """True while the window is below the slow-start threshold."""
        return self.bytes < self.threshold

    def on_acked(self, num_bytes: float) -> None:
        """Grows the window in slow start by the number of delivered bytes (RFC 5681, 3.1)."""
        self.bytes = min(self.bytes + num_bytes, max(self.threshold, MIN_WINDOW))

    def grow(self, now: float, seconds: float, round_trip: float) -> None:
        """Grows the window after an interval without congestion, outside slow start.

        Args:
            now: Time, seconds.
            seconds: Time since the last growth, seconds.
            round_trip: Smoothed round-trip time, seconds.
        """
        rounds = seconds / round_trip
        if self._epoch_start is None:
            self._epoch_start, self._reno_window = now - seconds, self.bytes
            self._max_window = max(self._max_window, self.bytes)
            self._k = ((self._max_window - self.bytes) / SEGMENT / C) ** (1 / 3)
        elapsed = now - self._epoch_start
        target = self._max_window + SEGMENT * C * (elapsed - self._k) ** 3
        self._reno_window += SEGMENT * rounds * (1.0 if self._reno_window >= self._max_window else RENO_FRIENDLY)
        self.bytes = min(max(self.bytes, target, self._reno_window), 1.5**rounds * self.bytes)

    def reduce(self, share: float = BETA, in_use: float = float("inf")) -> None:
        """Reduces the window after congestion to a share of the bytes in flight.

        Args:
            share: Size of the new window as a share of the bytes in flight, 0 to 1.
            in_use: Number of bytes in flight, limited to the old window. The default is a fully used window.
        """
        used = min(self.bytes, in_use)
        self._before_reduction = self.bytes, self.threshold
        self._max_window = used * (1 + BETA) / 2 if used < self._max_window else used
        self.bytes = self.threshold = max(share * used, MIN_WINDOW)
        self._epoch_start = None

    def exit_slow_start(self) -> None:
        """Ends slow start at the current window."""
        self.threshold = min(self.threshold, self.bytes)

    def undo(self) -> None:
        """Undoes the last reduction of the window, if its cause turned out not to be congestion."""
        if self._before_reduction:
            self.bytes, self.threshold = (
                max(self.bytes, self._before_reduction[0]),
                max(self.threshold, self._before_reduction[1]),
            )
            self._before_reduction, self._epoch_start = None, None

    def set(self, window: float) -> None:
        """Sets the window to a number of bytes and leaves slow start."""
        self.bytes = self.threshold = max(window, MIN_WINDOW)
        self._epoch_start = None

    def restart(self, threshold: float) -> None:
        """Restarts slow start after a feedback timeout.

        Args:
            threshold: New slow-start threshold, bytes.
        """
        self.threshold = max(threshold, MIN_WINDOW)
        self.bytes, self._epoch_start = max(min(INITIAL_WINDOW, self.bytes / 2), MIN_WINDOW), None
