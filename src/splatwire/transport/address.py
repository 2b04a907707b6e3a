"""Server addresses: parsing of `udp://`, `quic://` and `moq://` URLs."""

from dataclasses import dataclass, field
from urllib.parse import parse_qsl, quote, unquote, urlsplit

from splatwire.errors import InvalidValueError, shown

DEFAULT_PORT = 4840
_SAFE = "!$&'()*+,;=:@"
"""Characters that need no encoding in a part of a URL path, besides letters, digits and `-._~` (RFC 3986, 3.3)."""
PORTS = {"udp": DEFAULT_PORT, "quic": DEFAULT_PORT, "moq": 443}


@dataclass(frozen=True)
class Address:
    """Address of a server.

    Attributes:
        host: Host name or IP address.
        port: UDP port.
        name: Name of the requested stream; an empty name requests the server's first stream.
        scheme: `udp`, `quic`, or `moq` for a relay of Media over QUIC.
        token: Signed token that opens private scenes (`quic` only); empty without one.
        namespace: Path of the relay that comes before the name (`moq` only), percent-encoded; empty without one.
    """

    host: str
    port: int
    name: str = ""
    scheme: str = "udp"
    token: str = field(default="", repr=False)
    namespace: str = ""

    @property
    def authority(self) -> str:
        """Host and port as in a URL."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def url(self) -> str:
        """URL of the stream without its token, percent-encoded."""
        path = f"{self.namespace}/{quote(self.name, _SAFE)}".lstrip("/")
        return f"{self.scheme}://{self.authority}/{path}"


def check_port(port: int) -> None:
    """Checks the number of a port to listen on.

    Raises:
        InvalidValueError: If the number is not from 0 to 65535.
    """
    # Resolvers take larger numbers modulo 65536.
    if not 0 <= port < 1 << 16:
        raise InvalidValueError(f"a port is a number from 0 to 65535, {shown(port)} is not")


def cannot_listen(kind: str, host: str, port: int, error: OSError | UnicodeError) -> InvalidValueError:
    """Returns the exception for a server port that cannot be bound.

    Args:
        kind: Protocol of the port for the message, such as `UDP`.
        host: Address to listen on.
        port: Number of the port.
        error: Error of the operating system, or of an invalid host name.
    """
    reason = "it is no host name" if isinstance(error, UnicodeError) else error.strerror or error
    return InvalidValueError(f"cannot listen on {kind} port {port} of {host:.80}: {reason}")


def without_token(url: str) -> str:
    """Returns a URL without query, because the query may contain a token."""
    return url.partition("?")[0]


def parse_url(url: str) -> Address:
    """Parses a server URL.

    Its forms are `udp://HOST[:PORT][/NAME]`, `quic://HOST[:PORT][/NAME][?token=TOKEN]` and
    `moq://RELAY[:PORT][/PATH]/NAME`. NAME is the name of the requested stream, in which characters may be
    percent-encoded. The default port is 4840, or 443 for `moq`.

    Raises:
        InvalidValueError: If the text is not such a URL.
    """
    wrong = InvalidValueError(
        f"'{without_token(url)}' is not an address such as udp://localhost:{DEFAULT_PORT} or quic://localhost"
    )
    try:
        url.encode()  # bytes of a command line that are not UTF-8 are lone surrogates
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme in ("http", "https"):
        raise InvalidValueError(
            f"'{without_token(url)}' is not an address to receive from: curl downloads files, private ones with "
            "-H 'Authorization: Bearer TOKEN'"
        )
    query = parse_qsl(parts.query, keep_blank_values=True)
    token = query[0][1] if len(query) == 1 and query[0][0] == "token" else ""
    strange = (parts.query and not token) or parts.fragment or parts.username or port == 0
    if parts.scheme not in PORTS or not parts.hostname or strange:
        raise wrong
    if token and parts.scheme != "quic":
        raise InvalidValueError(
            f"'{without_token(url)}' with a token is not an address to receive from: tokens are for quic://, which is "
            "encrypted"
        )
    path = parts.path.strip("/")
    namespace, _, name = path.rpartition("/") if parts.scheme == "moq" else ("", "", path)
    name = unquote(name)
    if parts.scheme == "moq" and not name:
        raise InvalidValueError(f"'{without_token(url)}' names no scene: moq://RELAY/NAME")
    namespace = "/".join(quote(unquote(part), _SAFE) for part in namespace.split("/"))
    return Address(parts.hostname, PORTS[parts.scheme] if port is None else port, name, parts.scheme, token, namespace)
