"""Where a server is, as a person writes it."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from splatwire.errors import InvalidValueError

DEFAULT_PORT = 4840
SCHEMES = ("udp", "quic")


@dataclass(frozen=True)
class Address:
    """Where a server is.

    Attributes:
        host: Name or number.
        port: UDP port.
        name: Stream that is wanted; empty for the server's first.
        scheme: `udp` (datagrams of our own) or `quic` (the same in a QUIC connection).
    """

    host: str
    port: int
    name: str = ""
    scheme: str = "udp"


def cannot_listen(kind: str, host: str, port: int, error: OSError) -> InvalidValueError:
    """Says which port of which address cannot be listened on, and why."""
    return InvalidValueError(f"cannot listen on {kind} port {port} of {host}: {error.strerror or error}")


def parse_url(url: str) -> Address:
    """Reads `udp://HOST[:PORT][/NAME]` or `quic://HOST[:PORT][/NAME]`.

    Raises:
        InvalidValueError: If it is something else.
    """
    wrong = InvalidValueError(f"'{url}' is not an address such as udp://localhost:{DEFAULT_PORT} or quic://localhost")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme not in SCHEMES or not parts.hostname or parts.query or parts.fragment or parts.username:
        raise wrong
    return Address(parts.hostname, DEFAULT_PORT if port is None else port, parts.path.strip("/"), parts.scheme)
