"""Limit on the responses of a server to addresses that it has not validated."""

import socket
from collections.abc import Hashable
from typing import Any

WINDOW_S = 0.1
"""Period over which responses to unvalidated addresses are counted, seconds."""
MAX_RESPONSES = 1000
"""Maximum number of responses to unvalidated addresses per window. A response takes about 25 µs, so that
responses take at most a quarter of a core. The cost of reading and dropping further datagrams comes on top of that.
"""
MAX_ADDRESS_RESPONSES = 4
"""Maximum number of these responses per window to one address and port. Clients repeat their first datagram after 0.1
seconds or later.
"""
MAX_NETWORK_RESPONSES = 10
"""Maximum number of these responses to one network per window, once half of `MAX_RESPONSES` is used."""
_IPV4_MAPPED = bytes(10) + b"\xff\xff"
"""First bytes of IPv4-mapped IPv6 addresses, ::ffff:0:0/96."""


def network_key(address: Any) -> Hashable:
    """Returns a key for the network of a client: the IPv4 address, or the bytes of the /64 prefix of IPv6.

    IPv4 clients of a socket for both versions have IPv4-mapped addresses, and each is a network of its own. This
    function is faster than `network_of`, which also returns wider prefixes.

    Args:
        address: Socket address of the client.
    """
    host: str = address[0]
    if ":" not in host:
        return host
    try:
        packed = socket.inet_pton(socket.AF_INET6, host.partition("%")[0])
    except OSError:
        return host
    return packed if packed.startswith(_IPV4_MAPPED) else packed[:8]


class ResponseBudget:
    """Limit on the responses to unvalidated addresses within `WINDOW_S`.

    The number of responses is limited in total and per address. Once half of the total is used, the responses to each
    network are limited, too.
    """

    def __init__(self) -> None:
        self._until, self._num_responses = 0.0, 0
        self._addresses: dict[Hashable, int] = {}
        self._networks: dict[Hashable, int] = {}

    def may_respond(self, address: Any, now: float) -> bool:
        """Returns True if a response to a client may be sent.

        Args:
            address: Socket address of the client.
            now: Time, seconds.
        """
        if now >= self._until:
            self._until, self._num_responses = now + WINDOW_S, 0
            self._addresses.clear()
            self._networks.clear()
        if self._num_responses >= MAX_RESPONSES or self._addresses.get(address, 0) >= MAX_ADDRESS_RESPONSES:
            return False
        # The first half is for everybody, so that a forged address does not exclude its owner.
        return (
            2 * self._num_responses < MAX_RESPONSES
            or self._networks.get(network_key(address), 0) < MAX_NETWORK_RESPONSES
        )

    def take(self, address: Any, now: float) -> bool:
        """Counts a response to a client, and returns True if it may be sent.

        Args:
            address: Socket address of the client.
            now: Time, seconds.
        """
        if not self.may_respond(address, now):
            return False
        network = network_key(address)
        self._num_responses += 1
        self._addresses[address] = self._addresses.get(address, 0) + 1
        self._networks[network] = self._networks.get(network, 0) + 1
        return True
