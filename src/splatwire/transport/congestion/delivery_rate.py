"""Maximum number of bytes in flight over QUIC, derived from the delivery rate."""

from splatwire.transport.congestion.cubic import INITIAL_WINDOW
from splatwire.transport.congestion.path import WindowedMinFilter

GAIN = 2.0
"""Window as a multiple of the bandwidth-delay product (BBR's `cwnd_gain`). With 2, the window doubles each round trip
while the delivery rate grows.
"""
RATE_WINDOW_S, MIN_RTT_WINDOW_S = 1.0, 10.0
"""Periods over which the maximum delivery rate and the minimum round-trip time are taken, seconds."""


class DeliveryRateWindow:
    """Congestion window for a QUIC connection, computed from the rate at which the receiver acknowledges bytes.

    The window limits all bytes in flight. It shrinks when the delivery rate falls, not when packets are lost.

    Attributes:
        bytes: Congestion window, bytes.
    """

    def __init__(self) -> None:
        self.bytes = INITIAL_WINDOW
        self._max_rate_filter = WindowedMinFilter(RATE_WINDOW_S)
        self._min_rtt_filter = WindowedMinFilter(MIN_RTT_WINDOW_S)
        self._interval_start: float | None = None
        self._delivered = 0.0

    def on_acked(self, now: float, num_bytes: float, round_trip: float) -> None:
        """Updates the delivery rate and the window after an acknowledgement.

        Args:
            now: Time, seconds.
            num_bytes: Number of acknowledged bytes.
            round_trip: Round-trip time of the acknowledged packet, seconds.
        """
        min_rtt = self._min_rtt_filter.add(now, max(round_trip, 1e-3))
        if self._interval_start is None:
            self._interval_start = now - min_rtt
        self._delivered += num_bytes
        if now - self._interval_start >= min_rtt:
            max_rate = -self._max_rate_filter.add(now, -self._delivered / (now - self._interval_start))
            self.bytes = max(GAIN * max_rate * min_rtt, INITIAL_WINDOW)
            self._interval_start, self._delivered = now, 0.0
