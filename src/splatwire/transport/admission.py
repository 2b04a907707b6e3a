"""Who may begin a transfer: places and starts are counted by network, whatever port or address of it asks."""

import asyncio
import ipaddress
from collections import Counter, OrderedDict, deque
from collections.abc import Hashable, Mapping
from typing import TypeAlias

Network: TypeAlias = tuple[Hashable, ...]
"""Whom connections are counted by, behind the wider networks that it is in, the widest first."""
PREFIXES = {4: (24, 32), 6: (32, 48, 64)}
"""Bits of these. IPv6 addresses are counted by 64: the least that a network gives to a link (RFC 4291, 2.5.4), all of
whose 2^64 addresses one machine may take. One customer may have a /48 (RFC 6177), a provider a /32; of IPv4, a /24 is
the least that is routed. Strangers share those: they are asked for only where places run out (`makes_room`)."""
WINDOW_S = 60.0
"""Starts are counted over this time, longer than any token holds: so a token begins one transfer."""
MOST_NETWORKS = 4096
"""Networks whose starts are remembered; beyond, those that began something longest ago are forgotten."""


def network_of(address: Hashable) -> Network:
    """What addresses are counted by: an IPv4 address, the /64 prefix of an IPv6 address, or what is none as it is.

    Args:
        address: As a socket gives it: the host's number first.
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


def makes_room(held: Mapping[Network, int], newcomer: Network) -> Network | None:
    """Who gives a place to a newcomer where all are taken: the fullest network, if it has more than the newcomer's.

    First the widest networks are compared, the newcomer counted in; where none has more than the newcomer's, those
    within it, and so on. So whoever has many addresses of one network has as many places as a stranger's network.

    Args:
        held: Places of each network, above 0.
        newcomer: Whose connection is to have one.

    Returns:
        The network; None where nobody has more.
    """
    for depth in range(1, len(newcomer) + 1):
        found = _fullest(held, newcomer[: depth - 1], depth)
        if found is not None and found[1] > _places(held, newcomer[:depth]) + 1:
            return greediest(held, found[0])
    return None


def greediest(held: Mapping[Network, int], within: Network = ()) -> Network:
    """The network that holds most, of the wider network that does, and so on."""
    while within not in held:
        found = _fullest(held, within, len(within) + 1)
        assert found is not None
        within = found[0]
    return within


def _places(held: Mapping[Network, int], within: Network) -> int:
    return sum(count for network, count in held.items() if network[: len(within)] == within)


def _fullest(held: Mapping[Network, int], within: Network, depth: int) -> tuple[Network, int] | None:
    """Which of the networks within another one, so many prefixes long, holds most, and how much; None without any."""
    counts: Counter[Network] = Counter()
    for network, count in held.items():
        if network[: len(within)] == within:
            counts[network[:depth]] += count
    return counts.most_common(1)[0] if counts else None


class Places:
    """Connections at once, shared between networks: where all are taken, whoever holds most of them makes room.

    Args:
        most: Of all networks together.
        per_network: Of one network. Then somebody makes room only for one that holds fewer (`makes_room`); without
            this number the oldest of the greediest always goes.
    """

    def __init__(self, most: int, per_network: int | None = None) -> None:
        self._most, self._per_network = most, per_network
        self._held: dict[Network, list[asyncio.WriteTransport]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._held.values()))

    def take(self, network: Network, connection: asyncio.WriteTransport) -> bool:
        """Whether a connection has a place from now on. Another one may be ended for it."""
        if self._per_network is not None and len(self._held.get(network, ())) >= self._per_network:
            return False
        if len(self) >= self._most:
            counts = {other: len(held) for other, held in self._held.items()}
            full = greediest(counts) if self._per_network is None else makes_room(counts, network)
            if full is None:
                return False
            oldest = self._held[full][0]
            self.leave(full, oldest)
            oldest.abort()
        self._held.setdefault(network, []).append(connection)
        return True

    def leave(self, network: Network, connection: asyncio.WriteTransport) -> None:
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
        self._networks: OrderedDict[Network, deque[tuple[float, int]]] = OrderedDict()

    def seen(self, network: Network, nonce: int) -> bool:
        """Whether this attempt of a network has begun a transfer already."""
        return any(nonce == other for _, other in self._networks.get(network, ()))

    def allowed(self, network: Network, now: float) -> bool:
        """Whether a network may begin one more."""
        starts = self._networks.get(network, ())
        return sum(now - at < WINDOW_S for at, _ in starts) < self._most

    def note(self, network: Network, nonce: int, now: float) -> None:
        """A network begins a transfer."""
        self._networks.setdefault(network, deque(maxlen=self._most)).append((now, nonce))
        self._networks.move_to_end(network)
        if len(self._networks) > MOST_NETWORKS:
            self._networks.popitem(last=False)
