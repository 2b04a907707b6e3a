"""Where a server is, as a person writes it."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from splatwire.errors import InvalidValueError

DEFAULT_PORT = 4840
PORTS = {"udp": DEFAULT_PORT, "quic": DEFAULT_PORT, "moq": 443}


@dataclass(frozen=True)
class Address:
    """Where a server is.

    Attributes:
        host: Name or number.
        port: UDP port.
        name: Stream that is wanted; empty for the server's first.
        scheme: `udp` (datagrams of our own), `quic` (the same in a QUIC connection) or `moq` (a relay of Media over
            QUIC; the last part of the name is that of the scene there).
    """

    host: str
    port: int
    name: str = ""
    scheme: str = "udp"


def cannot_listen(kind: str, host: str, port: int, error: OSError) -> InvalidValueError:
    """Says which port of which address cannot be listened on, and why."""
    return InvalidValueError(f"cannot listen on {kind} port {port} of {host}: {error.strerror or error}")


def parse_url(url: str) -> Address:
    """Reads `udp://HOST[:PORT][/NAME]`, `quic://HOST[:PORT][/NAME]` or `moq://RELAY[:PORT]/NAME`.

    Raises:
        InvalidValueError: If it is something else.
    """
    wrong = InvalidValueError(f"'{url}' is not an address such as udp://localhost:{DEFAULT_PORT} or quic://localhost")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme not in PORTS or not parts.hostname or parts.query or parts.fragment or parts.username:
        raise wrong
    name = parts.path.strip("/")
    if parts.scheme == "moq" and not name:
        raise InvalidValueError(f"'{url}' names no scene: moq://RELAY/NAME")
    return Address(parts.hostname, PORTS[parts.scheme] if port is None else port, name, parts.scheme)
