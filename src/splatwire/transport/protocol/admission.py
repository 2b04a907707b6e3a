"""Admission control: limits concurrent connections and new transfers per network (IP prefix of the clients)."""

import asyncio
import ipaddress
from collections import Counter, OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

Network: TypeAlias = tuple[Hashable, ...]
"""Prefixes of an IP address, widest first. Clients are counted per address range of the last, narrowest prefix."""
PREFIXES = {4: (24, 32), 6: (32, 48, 64)}
"""Prefix lengths in bits, widest first, by IP version. Clients are counted per IPv4 address or IPv6 /64. A /64 is the
smallest prefix of a link (RFC 4291, 2.5.4), and one machine may use all addresses in it. One customer may have a /48
(RFC 6177), a provider a /32. For IPv4, a /24 is the smallest routed prefix. Unrelated users share the wider prefixes,
so these only matter when all slots are in use (`choose_eviction`).
"""
WINDOW_S = 60.0
"""Period over which new transfers of a network are counted, seconds. Longer than the lifetime of an address token, so
that the same token cannot start a second transfer.
"""
MAX_NETWORKS = 4096
"""Maximum number of networks whose new transfers are counted; the least recently active network is dropped first."""


def network_of(address: Hashable) -> Network:
    """Returns the network of a client as nested IP prefixes, the widest first.

    For IPv4, these are the /24 prefix and the address; for IPv6, the prefixes /32, /48 and /64.

    Args:
        address: Socket address whose first item is the IP address as text. Any other value counts as a network of its
            own.
    """
    if not (isinstance(address, tuple) and address and isinstance(address[0], str)):
        return (address,)
    try:
        host = ipaddress.ip_address(address[0].partition("%")[0])
    except ValueError:
        return (address[0],)
    if isinstance(host, ipaddress.IPv6Address):
        host = host.ipv4_mapped or host
    return tuple((bits, int(host) >> (host.max_prefixlen - bits)) for bits in PREFIXES[host.version])


def network_text(network: Network) -> str:
    """Returns the network of a client as text: an IPv4 address, or a /64 prefix of IPv6."""
    match network[-1:]:
        case ((int() as bits, int() as prefix),) if len(network) == len(PREFIXES[4]):
            return str(ipaddress.IPv4Address(prefix << (32 - bits)))
        case ((int() as bits, int() as prefix),) if len(network) == len(PREFIXES[6]):
            return f"{ipaddress.IPv6Address(prefix << (128 - bits))}/{bits}"
    return str(network[0])[:64] if network else "unknown"


def choose_eviction(connections: Mapping[Network, int], newcomer: Network) -> Network | None:
    """Chooses the network that must give up a connection in favour of a new one, when the server is full.

    Connections are shared fairly between IP prefixes, so that a client gains nothing by using many addresses.

    Args:
        connections: Number of connections per network, each above 0.
        newcomer: Network of the new connection.

    Returns:
        The network; None if the new connection is refused.
    """
    for depth in range(1, len(newcomer) + 1):
        largest = _largest_holder(connections, newcomer[: depth - 1], depth)
        if largest is not None and largest[1] > _num_connections(connections, newcomer[:depth]) + 1:
            return largest_holder(connections, largest[0])
    return None


def largest_holder(connections: Mapping[Network, int], prefix: Network = ()) -> Network:
    """Returns the network that should lose a connection when the server is full.

    The choice narrows down step by step, for IPv6 from a /32 prefix to a /48 prefix to a /64 prefix. Each step chooses
    the prefix with the most connections.

    Args:
        connections: Number of connections per network, each above 0.
        prefix: Prefixes that the network must start with; empty for any network.
    """
    while prefix not in connections:
        largest = _largest_holder(connections, prefix, len(prefix) + 1)
        assert largest is not None
        prefix = largest[0]
    return prefix


def _num_connections(connections: Mapping[Network, int], prefix: Network) -> int:
    """Returns the number of connections of all networks with the prefixes `prefix`."""
    return sum(count for network, count in connections.items() if network[: len(prefix)] == prefix)


def _largest_holder(connections: Mapping[Network, int], prefix: Network, depth: int) -> tuple[Network, int] | None:
    """Returns the IP prefix of a given depth with the most connections, and the number of these connections.

    The result is None if no network has the prefixes `prefix`.

    Args:
        connections: Number of connections per network. A network is a tuple of nested IP prefixes, the widest first.
        prefix: Prefixes that a network must start with; other networks are ignored.
        depth: Number of leading prefixes to compare. Networks with the same leading prefixes are counted together.
    """
    counts: Counter[Network] = Counter()
    for network, count in connections.items():
        if network[: len(prefix)] == prefix:
            counts[network[:depth]] += count
    return counts.most_common(1)[0] if counts else None


class ConnectionSlots:
    """Limit on concurrent connections, shared fairly between networks.

    If the limit is reached, a new connection can replace an old one. The replaced connection is the oldest one of a
    network that has many connections (`largest_holder`).

    Args:
        max_connections: Maximum number of connections in total.
        per_network: Maximum number of connections per network; None for no such maximum.
    """

    def __init__(self, max_connections: int, per_network: int | None = None) -> None:
        self._max_connections, self._per_network = max_connections, per_network
        self._connections: dict[Network, list[asyncio.WriteTransport]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._connections.values()))

    def take(self, network: Network, connection: asyncio.WriteTransport) -> bool:
        """Counts a new connection if the limits on connections permit it.

        If the total number of connections is at its limit, the oldest connection of a network with many connections may
        be aborted in favour of the new one.

        Args:
            network: Network of the client.
            connection: Transport of the new connection.

        Returns:
            True if the connection may stay. False if it must be refused.
        """
        if self._per_network is not None and len(self._connections.get(network, ())) >= self._per_network:
            return False
        if len(self) >= self._max_connections:
            counts = {other: len(held) for other, held in self._connections.items()}
            evicted = largest_holder(counts) if self._per_network is None else choose_eviction(counts, network)
            if evicted is None:
                return False
            oldest = self._connections[evicted][0]
            self.leave(evicted, oldest)
            oldest.abort()
        self._connections.setdefault(network, []).append(connection)
        return True

    def leave(self, network: Network, connection: asyncio.WriteTransport) -> None:
        """Removes an ended connection from the count, so that a new connection may take its place."""
        remaining = [other for other in self._connections.pop(network, []) if other is not connection]
        if remaining:
            self._connections[network] = remaining


@dataclass(slots=True)
class _Starts:
    """Transfers that clients of one network have started recently.

    Attributes:
        recent: Time in seconds and nonce of each new transfer, the oldest first.
        counts: Number of these transfers by nonce.
    """

    recent: list[tuple[float, int]] = field(default_factory=list)  # a deque takes 700 bytes for one start
    counts: dict[int, int] = field(default_factory=dict)

    def drop_oldest(self) -> None:
        """Removes the oldest transfer start from the record."""
        nonce = self.recent.pop(0)[1]
        self.counts[nonce] -= 1
        if not self.counts[nonce]:
            del self.counts[nonce]

    def is_expired(self, now: float) -> bool:
        """True if the record has no recent transfer start and can be deleted."""
        return not self.recent or now - self.recent[-1][0] >= WINDOW_S

    def drop_expired(self, now: float) -> None:
        """Forgets transfers that started more than `WINDOW_S` ago."""
        while self.recent and now - self.recent[0][0] >= WINDOW_S:
            self.drop_oldest()


class StartRateLimiter:
    """Limits how many transfers each network may start within `WINDOW_S`.

    Args:
        max_starts: Maximum number of new transfers per network within `WINDOW_S`.
    """

    def __init__(self, max_starts: int) -> None:
        self._max_starts = max_starts
        self._networks: OrderedDict[Network, _Starts] = OrderedDict()

    def __len__(self) -> int:
        """Number of recent transfers that are stored, summed over all IP networks."""
        return sum(len(starts.recent) for starts in self._networks.values())

    def has_started(self, network: Network, nonce: int) -> bool:
        """True if the network has recently started a transfer with this nonce, so that the request is a repetition.

        Args:
            network: Network of the client.
            nonce: Random number that identifies the client's connection attempt.
        """
        return network in self._networks and nonce in self._networks[network].counts

    def may_start(self, network: Network, now: float) -> bool:
        """True if the network may start another transfer at time `now`, seconds."""
        if (starts := self._networks.get(network)) is None:
            return True
        starts.drop_expired(now)
        return len(starts.recent) < self._max_starts

    def record(self, network: Network, nonce: int, now: float) -> None:
        """Counts a transfer that a client of the given network has started.

        Args:
            network: Network of the client.
            nonce: Number that identifies the client's connection attempt.
            now: Time, seconds.
        """
        starts = self._networks.setdefault(network, _Starts())
        starts.drop_expired(now)
        starts.recent.append((now, nonce))
        starts.counts[nonce] = starts.counts.get(nonce, 0) + 1
        if len(starts.recent) > self._max_starts:
            starts.drop_oldest()
        self._networks.move_to_end(network)
        while len(self._networks) > MAX_NETWORKS or next(iter(self._networks.values())).is_expired(now):
            self._networks.popitem(last=False)
