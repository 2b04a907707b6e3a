"""Limits on the processor time that a QUIC server spends on the datagrams of its clients."""

from collections import OrderedDict
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
"""Unused processor time of a connection: at most after its handshake, and the maximum, seconds."""
START_SHARE = 0.05
"""Start credits of all new connections of one network together, as a share of a processor core. Without start credit, a
new connection waits some milliseconds for its share.
"""
MAX_START_CREDIT_S = 0.5
"""Maximum processor time for start credits that a network saves, seconds."""
MIN_HANDSHAKE_SHARE, MAX_HANDSHAKE_SHARE = 0.05, 0.3
"""Handshakes of one network together: minimum and maximum share of a processor core."""
CONNECTION_HANDSHAKE_SHARE = 0.0015
"""Handshakes of one network together: share of a processor core for each connection that a network may have. Behind
a proxy, all clients are one network.
"""
MAX_HANDSHAKE_CREDIT_S = 1.0
"""Maximum processor time for handshakes that a network saves, seconds."""
MAX_HANDSHAKE_S = 0.1
"""Maximum processor time for the datagrams of one handshake, seconds."""
HANDSHAKE_RESERVE_S = 0.5
"""Processor time that is kept for handshakes in progress: no handshake begins while less is left, seconds."""
MAX_DATAGRAM_S = 0.02
"""Maximum processor time that counts for one datagram, seconds. No datagram takes longer because of its content. A
longer time is due to the server, such as a garbage collection, or the first request for a large stream.
"""
MAX_COUNTED_NETWORKS = 4096
"""Maximum number of networks whose processor time is counted; those that connected longest ago are dropped beyond it.
"""


class InputBudget:
    """Limit on the processor time for the datagrams of one connection (token bucket).

    Args:
        credit: Processor time that the connection may use at once, seconds.
        now: Time, seconds.

    Attributes:
        credit: Processor time that is left, seconds; negative after a datagram that took longer.
    """

    def __init__(self, credit: float, now: float) -> None:
        self.credit, self._at = credit, now

    def is_spent(self, num_connections: int, now: float) -> bool:
        """Returns True if no processor time is left: then the datagram must be dropped.

        Args:
            num_connections: Number of connections of the client's network. They share `MAX_NETWORK_SHARE` of a core.
            now: Time, seconds.
        """
        share = min(MAX_SHARE, MAX_NETWORK_SHARE / max(num_connections, 1))
        self.credit = min(self.credit + share * (now - self._at), MAX_CREDIT_S)
        self._at = now
        return self.credit <= 0

    def spend(self, seconds: float) -> None:
        """Counts processor time that was spent on a datagram of the client, seconds; `MAX_DATAGRAM_S` at most."""
        self.credit -= min(seconds, MAX_DATAGRAM_S)

    def earn(self, seconds: float) -> None:
        """Counts processor time that was spent on sending data to the client, seconds."""
        self.credit = min(self.credit + EARNED_FACTOR * seconds, MAX_CREDIT_S)


class _NetworkCredit:
    """Processor time of one network that is left for handshakes and for new connections, seconds.

    Args:
        now: Time, seconds.
    """

    __slots__ = ("_at", "handshakes", "starts")

    def __init__(self, now: float) -> None:
        self.handshakes, self.starts, self._at = MAX_HANDSHAKE_CREDIT_S, MAX_START_CREDIT_S, now

    def refill(self, handshake_share: float, now: float) -> None:
        """Adds the network's shares of the time since the last call.

        Args:
            handshake_share: Share of a processor core for handshakes.
            now: Time, seconds.
        """
        seconds, self._at = now - self._at, now
        self.handshakes = min(self.handshakes + handshake_share * seconds, MAX_HANDSHAKE_CREDIT_S)
        self.starts = min(self.starts + START_SHARE * seconds, MAX_START_CREDIT_S)


class NetworkBudgets:
    """Limits on the processor time for handshakes and new connections of each network.

    Connections come and go, and the budget of their network stays: a client that connects again and again gets no more
    than one that stays.

    Args:
        per_network: Maximum number of concurrent connections of one network.
    """

    def __init__(self, per_network: int) -> None:
        share = max(CONNECTION_HANDSHAKE_SHARE * per_network, MIN_HANDSHAKE_SHARE)
        self._handshake_share = min(share, MAX_HANDSHAKE_SHARE)
        self._networks: OrderedDict[Hashable, _NetworkCredit] = OrderedDict()

    def may_begin(self, network: Hashable, now: float) -> bool:
        """Returns True if a client may begin a handshake.

        Args:
            network: Network of the client.
            now: Time, seconds.
        """
        return self._credit_of(network, now).handshakes > HANDSHAKE_RESERVE_S

    def may_continue(self, network: Hashable, now: float) -> bool:
        """Returns True if a datagram of a handshake in progress may be processed.

        Args:
            network: Network of the client.
            now: Time, seconds.
        """
        return self._credit_of(network, now).handshakes > 0

    def spend(self, network: Hashable, seconds: float, now: float) -> None:
        """Counts processor time that was spent on a datagram of a handshake.

        Args:
            network: Network of the client.
            seconds: Processor time, seconds; counts at most `MAX_DATAGRAM_S`.
            now: Time, seconds.
        """
        self._credit_of(network, now).handshakes -= min(seconds, MAX_DATAGRAM_S)

    def open(self, network: Hashable, now: float) -> InputBudget:
        """Returns the budget of a new connection, with a start credit as far as its network has any left.

        Args:
            network: Network of the client.
            now: Time, seconds.
        """
        credit = self._credit_of(network, now)
        start = min(START_CREDIT_S, max(credit.starts, 0.0))
        credit.starts -= start
        return InputBudget(start, now)

    def close(self, network: Hashable, budget: InputBudget, now: float) -> None:
        """Gives the rest of the credit of an ended connection, or its debt, to its network.

        Args:
            network: Network of the client.
            budget: Budget of the connection, which has no credit afterwards.
            now: Time, seconds.
        """
        credit = self._credit_of(network, now)
        returned = credit.starts + min(budget.credit, START_CREDIT_S)
        credit.starts = min(max(returned, -MAX_START_CREDIT_S), MAX_START_CREDIT_S)  # debt lasts seconds, not for ever
        budget.credit = 0.0

    def _credit_of(self, network: Hashable, now: float) -> _NetworkCredit:
        """Returns the credit of a network at time `now`, seconds."""
        credit = self._networks.get(network)
        if credit is None:
            credit = self._networks[network] = _NetworkCredit(now)
            if len(self._networks) > MAX_COUNTED_NETWORKS:
                self._networks.popitem(last=False)
        credit.refill(self._handshake_share, now)
        self._networks.move_to_end(network)
        return credit
