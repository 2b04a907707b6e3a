"""Parsing of web origins (RFC 6454), which identify the pages that may read streams."""

import functools
import ipaddress
import re
import socket
import time
from urllib.parse import urlsplit

from splatwire.errors import InvalidValueError

RESOLVED_FOR_S = 10.0
"""Time for which the result of a name resolution is kept, seconds."""
_ORIGIN = re.compile(r"(https?)://(\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z._-]+)(?::([0-9]{1,5}))?")


def parse_origin(text: str) -> str:
    """Parses a web origin, `http[s]://HOST[:PORT]`, into the spelling of browsers (RFC 6454).

    Args:
        text: Web origin as typed by a user; a trailing slash is ignored.

    Returns:
        Web origin in lower case, without the default port of the scheme.

    Raises:
        InvalidValueError: If the text is not a web origin, for instance a URL with a path.
    """
    match = _ORIGIN.fullmatch(text.strip().removesuffix("/"))
    if match is None or int(match[3] or 0) >= 1 << 16:
        raise InvalidValueError(f"'{text}' is not a web origin such as https://example.org or http://localhost:8080")
    scheme, host, port = match[1], match[2].lower(), match[3]
    default = {"http": 80, "https": 443}[scheme]
    return f"{scheme}://{host}" if port is None or int(port) == default else f"{scheme}://{host}:{int(port)}"


def host_of(origin: str) -> str:
    """Returns the host of a web origin without its port."""
    host = urlsplit(origin).hostname or ""
    return f"[{host}]" if ":" in host else host


def is_loopback(host: str) -> bool:
    """Returns True for a loopback name or address: `localhost`, 127.0.0.0/8 or `::1`."""
    plain = host.strip("[]").lower().removesuffix(".")
    try:
        return ipaddress.ip_address(plain).is_loopback
    except ValueError:
        return plain == "localhost" or plain.endswith(".localhost")


def listens_on_loopback(host: str) -> bool:
    """Returns True if a server that listens on a host is reachable from this machine only.

    Args:
        host: Name or address that the server listens on; a name is resolved, and may be the name of this machine. Not
            for names that others choose.
    """
    if not host or is_loopback(host):
        return bool(host)
    return _resolves_to_loopback(host, int(time.monotonic() // RESOLVED_FOR_S))


@functools.lru_cache(maxsize=64)
def _resolves_to_loopback(host: str, period: int) -> bool:
    """Resolves a name; the result, also that of a failure, is kept for a period of `RESOLVED_FOR_S`."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    return bool(found) and all(is_loopback(str(address[0])) for *_, address in found)


def is_loopback_origin(origin: str | None) -> bool:
    """Returns True if a web origin belongs to a page served from this machine."""
    return origin is not None and _ORIGIN.fullmatch(origin) is not None and is_loopback(host_of(origin))
