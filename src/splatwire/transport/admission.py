"""Who may begin a transfer: places and starts are counted by network, whatever port or address of it asks."""

import asyncio
import ipaddress
from collections import OrderedDict, deque
from collections.abc import Hashable

PREFIX_BITS = 64
"""IPv6 addresses are counted by this prefix: the least that a network gives to a link (RFC 4291, 2.5.4), all of whose
2^64 addresses one machine may take. A shorter one would count strangers together who share a provider."""
WINDOW_S = 60.0
"""Starts are counted over this time, longer than any token holds: so a token begins one transfer."""
MOST_NETWORKS = 4096
"""Networks whose starts are remembered; beyond, those that began something longest ago are forgotten."""


def network_of(address: Hashable) -> Hashable:
    """What addresses are counted by: an IPv4 address, the /64 prefix of an IPv6 address, or what is none as it is.

    Args:
        address: As a socket gives it: the host's number first.
    """
    if not (isinstance(address, tuple) and address and isinstance(address[0], str)):
        return address
    try:
        number = ipaddress.ip_address(address[0].partition("%")[0])
    except ValueError:
        return address[0]
    if isinstance(number, ipaddress.IPv6Address):
        return number.ipv4_mapped or int(number) >> (128 - PREFIX_BITS)
    return number


class Places:
    """Connections at once, shared between networks: where all are taken, whoever holds most of them makes room.

    Args:
        most: Of all networks together.
        per_network: Of one network. Then the greediest makes room only for one that holds fewer, the new one counted;
            without this number the oldest of the greediest always goes.
    """

    def __init__(self, most: int, per_network: int | None = None) -> None:
        self._most, self._per_network = most, per_network
        self._held: dict[Hashable, list[asyncio.WriteTransport]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._held.values()))

    def take(self, network: Hashable, connection: asyncio.WriteTransport) -> bool:
        """Whether a connection has a place from now on. Another one may be ended for it."""
        mine = len(self._held.get(network, ())) + 1
        if self._per_network is not None and mine > self._per_network:
            return False
        if len(self) >= self._most:
            greediest = max(self._held, key=lambda other: len(self._held[other]))
            if self._per_network is not None and len(self._held[greediest]) <= mine:
                return False
            oldest = self._held[greediest][0]
            self.leave(greediest, oldest)
            oldest.abort()
        self._held.setdefault(network, []).append(connection)
        return True

    def leave(self, network: Hashable, connection: asyncio.WriteTransport) -> None:
        """A connection needs its place no more; nothing happens if it had lost it."""
        left = [other for other in self._held.pop(network, []) if other is not connection]
        if left:
            self._held[network] = left


class Starts:
    """Who began which transfers within the last `WINDOW_S`. Bounded: a few starts of a few thousand networks.

    Args:
        most: Starts of one network within that time.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._networks: OrderedDict[Hashable, deque[tuple[float, int]]] = OrderedDict()

    def seen(self, network: Hashable, nonce: int) -> bool:
        """Whether this attempt of a network has begun a transfer already."""
        return any(nonce == other for _, other in self._networks.get(network, ()))

    def allowed(self, network: Hashable, now: float) -> bool:
        """Whether a network may begin one more."""
        starts = self._networks.get(network, ())
        return sum(now - at < WINDOW_S for at, _ in starts) < self._most

    def note(self, network: Hashable, nonce: int, now: float) -> None:
        """A network begins a transfer."""
        self._networks.setdefault(network, deque(maxlen=self._most)).append((now, nonce))
        self._networks.move_to_end(network)
        if len(self._networks) > MOST_NETWORKS:
            self._networks.popitem(last=False)
