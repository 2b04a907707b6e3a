"""Server addresses: parsing of `udp://`, `quic://` and `moq://` URLs."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from splatwire.errors import InvalidValueError

DEFAULT_PORT = 4840
PORTS = {"udp": DEFAULT_PORT, "quic": DEFAULT_PORT, "moq": 443}


@dataclass(frozen=True)
class Address:
    """Address of a server.

    Attributes:
        host: Host name or IP address.
        port: UDP port.
        name: Name of the requested stream; an empty name requests the server's first stream.
        scheme: `udp` (splatwire datagrams), `quic` (the same datagrams in a QUIC connection) or `moq` (a relay of
            Media over QUIC; the last part of the name is the scene's name at the relay).
    """

    host: str
    port: int
    name: str = ""
    scheme: str = "udp"


def cannot_listen(kind: str, host: str, port: int, error: OSError | UnicodeError) -> InvalidValueError:
    """Returns the exception for a server port that cannot be bound; the message has port, address and reason.

    Args:
        kind: Protocol of the port for the message, such as `UDP`.
        host: Address to listen on.
        port: Number of the port.
        error: Error of the operating system; a UnicodeError if the host name has a label of more than 63 characters.
    """
    reason = "it is no host name" if isinstance(error, UnicodeError) else error.strerror or error
    return InvalidValueError(f"cannot listen on {kind} port {port} of {host:.80}: {reason}")


def parse_url(url: str) -> Address:
    """Parses a server URL: `udp://HOST[:PORT][/NAME]`, `quic://HOST[:PORT][/NAME]` or `moq://RELAY[:PORT]/NAME`.

    NAME is the name of the requested stream. The default port is 4840, or 443 for `moq`.

    Raises:
        InvalidValueError: If the text is not such a URL.
    """
    wrong = InvalidValueError(f"'{url}' is not an address such as udp://localhost:{DEFAULT_PORT} or quic://localhost")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme in ("http", "https") or (parts.scheme in PORTS and parts.query):
        raise InvalidValueError(
            f"'{parts.scheme}://{parts.netloc}{parts.path}' with a token or HTTP is not an address to receive from: "
            "private scenes are sent over HTTP only, as files: curl -H 'Authorization: Bearer TOKEN' -o scene.swz "
            "https://HOST/private/NAME.swz"
        )
    if parts.scheme not in PORTS or not parts.hostname or parts.query or parts.fragment or parts.username:
        raise wrong
    name = parts.path.strip("/")
    if parts.scheme == "moq" and not name:
        raise InvalidValueError(f"'{url}' names no scene: moq://RELAY/NAME")
    return Address(parts.hostname, PORTS[parts.scheme] if port is None else port, name, parts.scheme)
