"""Limits on the processor time that a QUIC server spends on the datagrams of its clients."""

from collections.abc import Hashable

MAX_SHARE = 0.1
"""Share of a processor core that the datagrams of one connection may always take; sending to it earns more, see
`EARNED_FACTOR`.
"""
MAX_NETWORK_SHARE = 0.3
"""Like `MAX_SHARE`, for all connections of one network together."""
EARNED_FACTOR = 2.0
"""Processor time for a client's datagrams, relative to the processor time for sending data to the client.
Acknowledgements and reports of a transfer need time, too.
"""
START_CREDIT_S, MAX_CREDIT_S = 0.05, 0.25
"""Unused processor time of a connection: after its handshake, and the maximum, seconds."""
MAX_DATAGRAM_S = 0.02
"""Maximum processor time that counts for one datagram, seconds. No datagram takes longer because of its content. A
longer time is due to the server, such as a garbage collection, or the first request for a large stream.
"""
HANDSHAKE_WINDOW_S = 10.0
"""Period over which the processor time for handshakes is counted, seconds."""
MAX_HANDSHAKE_S = 3.0
"""Maximum processor time for handshakes of one network within `HANDSHAKE_WINDOW_S`, seconds."""
MAX_COUNTED_NETWORKS = 4096
"""Maximum number of networks whose processor time for handshakes is counted."""


class InputBudget:
    """Limit on the processor time for the datagrams of one connection (token bucket).

    Args:
        now: Time, seconds.
    """

    def __init__(self, now: float) -> None:
        self._credit, self._at = START_CREDIT_S, now

    def is_spent(self, num_connections: int, now: float) -> bool:
        """Returns True if no processor time is left, so that a datagram must be dropped.

        Args:
            num_connections: Number of connections of the client's network, which share `MAX_NETWORK_SHARE`.
            now: Time, seconds.
        """
        share = min(MAX_SHARE, MAX_NETWORK_SHARE / max(num_connections, 1))
        self._credit = min(self._credit + share * (now - self._at), MAX_CREDIT_S)
        self._at = now
        return self._credit <= 0

    def spend(self, seconds: float) -> None:
        """Counts processor time that was spent on a datagram of the client, seconds; `MAX_DATAGRAM_S` at most."""
        self._credit -= min(seconds, MAX_DATAGRAM_S)

    def earn(self, seconds: float) -> None:
        """Counts processor time that was spent on sending data to the client, seconds."""
        self._credit = min(self._credit + EARNED_FACTOR * seconds, MAX_CREDIT_S)


class HandshakeTime:
    """Limit on the processor time for the datagrams of unfinished handshakes, for each network."""

    def __init__(self) -> None:
        self._until = 0.0
        self._seconds: dict[Hashable, float] = {}

    def is_spent(self, network: Hashable, now: float) -> bool:
        """Returns True if no processor time is left for handshakes of a network.

        Args:
            network: Network of the client.
            now: Time, seconds.
        """
        if now >= self._until or len(self._seconds) > MAX_COUNTED_NETWORKS:
            self._until = now + HANDSHAKE_WINDOW_S
            self._seconds.clear()
        return self._seconds.get(network, 0.0) >= MAX_HANDSHAKE_S

    def spend(self, network: Hashable, seconds: float) -> None:
        """Counts processor time that was spent on a handshake.

        Args:
            network: Network of the client.
            seconds: Processor time, seconds.
        """
        self._seconds[network] = self._seconds.get(network, 0.0) + seconds
