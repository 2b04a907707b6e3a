"""Trusted reverse proxies: the address of a client from the header `X-Forwarded-For`."""

import ipaddress
import re
from collections.abc import Sequence
from typing import Any, TypeAlias

from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.transport.http.messages import read_request

IpNetwork: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network
_WITH_PORT = re.compile(r"(?:([0-9.]+)|\[([0-9A-Fa-f:.]+)\])(?::[0-9]+)?")


def parse_networks(texts: Sequence[str]) -> tuple[IpNetwork, ...]:
    """Parses IP addresses and networks such as `10.0.0.0/8` or `::1`.

    Raises:
        InvalidValueError: If a text is neither an IP address nor a network.
    """
    try:
        return tuple(ipaddress.ip_network(text.strip()) for text in texts)
    except ValueError as error:
        raise InvalidValueError(f"a proxy is an IP address or a network such as 10.0.0.0/8: {error}") from error


def client_address(peer: Any, head: bytes, proxies: Sequence[IpNetwork]) -> tuple[str]:
    """Returns the IP address of the client that sent an HTTP request, as a socket address without port.

    If the connection comes from a trusted proxy, this is the last address in `X-Forwarded-For` that is not a trusted
    proxy. Otherwise it is the address of the connection.

    Args:
        peer: Socket address of the other end of the connection.
        head: Head of the HTTP request.
        proxies: Networks of trusted proxies.
    """
    address = str(peer[0])
    try:
        listed = read_request(head).headers.get("x-forwarded-for", "").split(",")
    except BitstreamError:
        return (address,)
    # Each proxy appends the address of its client. Addresses before the first untrusted one may be forged.
    while _is_trusted(address, proxies) and listed:
        try:
            address = str(ipaddress.ip_address(_without_port(listed.pop().strip())))
        except ValueError:
            break
    return (address,)


def _without_port(text: str) -> str:
    """Returns an address without the port that some proxies append: `192.0.2.1:443` or `[2001:db8::1]:443`."""
    match = _WITH_PORT.fullmatch(text)
    return text if match is None else match[1] or match[2]


def _is_trusted(address: str, proxies: Sequence[IpNetwork]) -> bool:
    try:
        host = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    if isinstance(host, ipaddress.IPv6Address):
        host = host.ipv4_mapped or host
    return any(host in network for network in proxies)
