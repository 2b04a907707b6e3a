"""How much may be under way over QUIC: as much as is delivered in two round trips."""

from splatwire.transport.cubic import INITIAL
from splatwire.transport.path import Extremum

GAIN = 2.0
"""Bandwidth-delay products under way (BBR's `cwnd_gain`): it doubles each round trip while more is delivered."""
RATE_WINDOW_S, LEAST_WINDOW_S = 1.0, 10.0


class DeliveredWindow:
    """Bounds what QUIC has under way: symbols of the reliable stream and what is sent again of them.

    The receiver's reports, which govern the rate, tell of datagrams alone. This bound follows what QUIC acknowledges;
    lost packets do not shrink it, fewer delivered bytes do.

    Attributes:
        bytes: The window.
    """

    def __init__(self) -> None:
        self.bytes = INITIAL
        self._fastest, self._least = Extremum(RATE_WINDOW_S), Extremum(LEAST_WINDOW_S)
        self._since: float | None = None
        self._delivered = 0.0

    def arrived(self, now: float, num_bytes: float, round_trip: float) -> None:
        """Takes bytes that were acknowledged.

        Args:
            now: Time, seconds.
            num_bytes: How many.
            round_trip: Of the packet, seconds.
        """
        least = self._least.add(now, max(round_trip, 1e-3))
        if self._since is None:
            self._since = now - least
        self._delivered += num_bytes
        if now - self._since >= least:
            fastest = -self._fastest.add(now, -self._delivered / (now - self._since))
            self.bytes = max(GAIN * fastest * least, INITIAL)
            self._since, self._delivered = now, 0.0
