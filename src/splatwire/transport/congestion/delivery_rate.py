"""Maximum number of bytes in flight over QUIC, derived from the delivery rate."""

from splatwire.transport.congestion.cubic import INITIAL_WINDOW
from splatwire.transport.congestion.path import WindowedMinFilter

GAIN = 2.0
"""Window as a multiple of the bandwidth-delay product (BBR's `cwnd_gain`). With 2, the window doubles each round trip
while the delivery rate grows.
"""
RATE_WINDOW_S, MIN_WINDOW_S = 1.0, 10.0


class DeliveryRateWindow:
    """Congestion window for a QUIC connection, computed from the rate at which the receiver acknowledges bytes.

    The window limits all bytes in flight. It shrinks when the delivery rate falls, not when packets are lost.

    Attributes:
        bytes: Congestion window, bytes.
    """

    def __init__(self) -> None:
        self.bytes = INITIAL_WINDOW
        self._fastest, self._least = WindowedMinFilter(RATE_WINDOW_S), WindowedMinFilter(MIN_WINDOW_S)
        self._since: float | None = None
        self._delivered = 0.0

    def on_acked(self, now: float, num_bytes: float, round_trip: float) -> None:
        """Updates the delivery rate and the window after an acknowledgement.

        Args:
            now: Time, seconds.
            num_bytes: Number of acknowledged bytes.
            round_trip: Round-trip time of the acknowledged packet, seconds.
        """
        least = self._least.add(now, max(round_trip, 1e-3))
        if self._since is None:
            self._since = now - least
        self._delivered += num_bytes
        if now - self._since >= least:
            fastest = -self._fastest.add(now, -self._delivered / (now - self._since))
            self.bytes = max(GAIN * fastest * least, INITIAL_WINDOW)
            self._since, self._delivered = now, 0.0
