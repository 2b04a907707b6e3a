"""What the verbs that serve share: a server on a port, over UDP or QUIC, and the page beside it."""

import contextlib
import socket
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.transport import Program, ServerLimits
    from splatwire.transport.certificate import Identity
    from splatwire.transport.quic_server import QuicServer
    from splatwire.transport.udp import UdpServer


@dataclass(frozen=True)
class Listening:
    """Where and how is served.

    Attributes:
        host: Address to listen on.
        port: UDP port; 0 lets the system choose.
        quic: Whether over QUIC.
        page: With QUIC: TCP port of the page; None for none.
        certificate: With QUIC: certificate and its chain (PEM); None for one that is made on the spot.
        key: Its private key.
        origins: Web pages that may open sessions; empty lets all.
        limits: What is spent on clients.
    """

    host: str
    port: int
    quic: bool
    page: int | None
    certificate: Path | None
    key: Path | None
    origins: tuple[str, ...]
    limits: "ServerLimits"

    def identity(self) -> "Callable[[], Identity]":
        """What gives the certificate and key of a QUIC server; one that was made on the spot is renewed.

        Raises:
            InvalidValueError: If only one of them was given, or they are something else.
        """
        from splatwire.transport.certificate import RenewedIdentity, from_pem

        if (self.certificate is None) != (self.key is None):
            raise InvalidValueError("--certificate and --key belong together")
        if self.certificate is None or self.key is None:
            hosts = ("localhost", "127.0.0.1", "::1", socket.gethostname(), self.host)
            return RenewedIdentity(hosts, told=_told_renewed)
        given = from_pem(self.certificate.read_bytes(), self.key.read_bytes())
        return lambda: given


def check_port(port: int) -> None:
    """Refuses what is no port.

    Raises:
        InvalidValueError: If it is none.
    """
    if not 0 <= port < 1 << 16:
        raise InvalidValueError(f"a port is a number from 0 to 65535, {port} is not")


async def open_server(
    programs: "Mapping[str, Program]", listening: Listening, stack: contextlib.AsyncExitStack, live: str | None = None
) -> "tuple[UdpServer | QuicServer, dict[str, str]]":
    """A server, and what its clients have to know of it.

    Args:
        programs: Streams by name.
        listening: Where and how.
        stack: Closes it.
        live: Name of a stream that grows, which the page shows.
    """
    host, port, limits = listening.host, listening.port, listening.limits
    if not listening.quic:
        from splatwire.transport.udp import UdpServer

        plain = UdpServer(programs, host, port, limits=limits)
        stack.callback(plain.close)
        return plain, {}
    from splatwire.transport.quic import WEBTRANSPORT_PATH, QuicLimits, need_aioquic

    need_aioquic()
    from splatwire.transport.page import PageLimits, PageServer
    from splatwire.transport.page_content import Link, PageContent
    from splatwire.transport.quic_server import QuicServer

    identity = listening.identity()
    spent = QuicLimits(2 * limits.sessions, 2 * limits.per_network, listening.origins or None)
    server = QuicServer(programs, host, port, identity=identity, limits=limits, quic_limits=spent)
    stack.callback(server.close)
    await server.start()
    facts = {"fingerprint": identity().fingerprint}
    if listening.page is not None:

        def link() -> Link:
            return Link(server.port, WEBTRANSPORT_PATH, None if listening.certificate else identity().fingerprint)

        shown = {live: None} if live is not None else programs
        content = PageContent(shown, link, host, listening.origins or None)
        page_limits = PageLimits(limits.sessions, 2 * limits.per_network)
        page = await stack.enter_async_context(PageServer(content, listening.page, page_limits))
        facts["page"] = page.url
    return server, facts


def _told_renewed(identity: "Identity") -> None:
    """Says by which fingerprint a server is known from here on."""
    print(f"the certificate was renewed; fingerprint: {identity.fingerprint}", file=sys.stderr, flush=True)
