"""What the verbs that serve share: a server on a port, over UDP or QUIC, and the page beside it."""

import asyncio
import contextlib
import errno
import math
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._output import JsonFlag, print_json
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.transport import Program, ServerLimits
    from splatwire.transport.certificate import Identity
    from splatwire.transport.page import PageServer
    from splatwire.transport.quic_server import QuicServer
    from splatwire.transport.udp import UdpServer

REPORT_S = 5.0
"""Least time between two reports of errors that no request waits for, seconds."""


@dataclass(frozen=True, kw_only=True)
class Listening:
    """The options of the verbs that serve: where and how."""

    port: int = 4840
    """UDP port; 0 lets the system choose."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all of this machine's."""
    rate: float | None = None
    """Megabits per second to each client, fixed; without it the rate adapts to the path."""
    quic: bool = False
    """Serve over QUIC: encrypted, side information on a reliable stream; browsers may come by WebTransport."""
    page: int | None = None
    """Serve a page that receives and draws in a browser, on this TCP port; 0 lets the system choose. Implies --quic."""
    public_url: str | None = None
    """With --page: address by which visitors reach the page, e.g. https://splats.example.org, through a proxy."""
    certificate: Path | None = None
    """With --quic: certificate and its chain (PEM); without it one is made on the spot and its fingerprint told."""
    key: Path | None = None
    """Private key of the certificate (PEM, not encrypted)."""
    json: JsonFlag = False
    """Print one JSON object when ready."""

    @property
    def over_quic(self) -> bool:
        """Whether over QUIC."""
        return self.quic or self.page is not None

    @property
    def fixed_rate(self) -> float | None:
        """Bytes per second to each client; None adapts."""
        return None if self.rate is None else self.rate * 1e6 / 8

    def check_listening(self) -> None:
        """Tells mistakes before any work.

        Raises:
            InvalidValueError: If a port or the rate is out of range, or a certificate was given for plain UDP.
        """
        check_port(self.port)
        check_port(self.page or 0)
        if not self.over_quic and (self.certificate or self.key):
            raise InvalidValueError("--certificate and --key are for --quic")
        if self.public_url is not None and self.page is None:
            raise InvalidValueError("--public-url is for --page")
        self.public_origin()
        if self.rate is not None and not 0 < self.rate <= 100_000:
            raise InvalidValueError(f"a rate is above 0 and at most 100000 megabits per second, {self.rate} is not")

    def public_origin(self) -> str | None:
        """Web origin of `public_url`; None where it is absent.

        Raises:
            InvalidValueError: If it is no address of a page at the root of its host.
        """
        from splatwire.transport.origins import parse_origin

        return None if self.public_url is None else parse_origin(self.public_url)

    def tell_ready(self, port: int, facts: "Mapping[str, str]", what: str, **more: Any) -> None:
        """Prints where clients come to, and what they have to know."""
        if self.json:
            print_json({"host": self.host, "port": port, **more, **facts})
        else:
            print(f"{what} on {'quic' if self.over_quic else 'udp'}://{url_host(self.host)}:{port}")
            for name, value in facts.items():
                print(f"{name}: {value}")
        sys.stdout.flush()

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


@dataclass(frozen=True, eq=False)
class Opened:
    """A server that listens.

    Attributes:
        server: Serves over UDP or QUIC.
        facts: Facts that clients need, by name.
        page: Serves the page and streams over HTTP; None without one.
    """

    server: "UdpServer | QuicServer"
    facts: dict[str, str]
    page: "PageServer | None" = None

    def served(self) -> str:
        """Counts of clients, answers and bytes, as text."""
        text = f"served {self.server.core.num_served} clients, {self.server.bytes_sent:,} bytes"
        if self.page is None:
            return text
        return f"{text}, and {self.page.num_answers:,} requests over HTTP, {self.page.bytes_sent:,} bytes"


async def open_server(
    programs: "Mapping[str, Program]", listening: Listening, limits: "ServerLimits", stack: contextlib.AsyncExitStack,
    *, origins: tuple[str, ...] = (), live: str | None = None,
) -> "Opened":  # fmt: skip
    """Opens a server, and the page beside it.

    Args:
        programs: Streams by name.
        listening: Where and how.
        limits: What is spent on clients.
        stack: Closes it.
        origins: Web pages that may open sessions; empty lets all.
        live: Name of a stream that grows, which the page shows.
    """
    host, port = listening.host, listening.port
    if not listening.over_quic:
        from splatwire.transport.udp import UdpServer

        plain = UdpServer(programs, host, port, limits=limits)
        stack.callback(plain.close)
        return Opened(plain, {})
    from splatwire.transport.quic import WEBTRANSPORT_PATH, QuicLimits, need_aioquic

    need_aioquic()
    from splatwire.transport.page import PageLimits, PageServer
    from splatwire.transport.page_content import Link, PageContent
    from splatwire.transport.quic_server import QuicServer

    identity = listening.identity()
    spent = QuicLimits(2 * limits.sessions, 2 * limits.per_network, origins or None)
    server = QuicServer(programs, host, port, identity=identity, limits=limits, quic_limits=spent)
    stack.callback(server.close)
    await server.start()
    facts, page = {"fingerprint": identity().fingerprint}, None
    if listening.page is not None:

        def link() -> Link:
            return Link(server.port, WEBTRANSPORT_PATH, None if listening.certificate else identity().fingerprint)

        shown = {live: None} if live is not None else programs
        public = listening.public_origin()
        content = PageContent(shown, link, host, origins or None, public)
        page_limits = PageLimits(limits.sessions, 2 * limits.per_network)
        page = await stack.enter_async_context(PageServer(content, listening.page, page_limits))
        facts["page"] = page.url if public is None else f"{public}/"
        if origins:  # the page itself opens sessions, too
            own = (public or f"http://localhost:{page.port}", page.url.rstrip("/"))
            server.limits = replace(server.limits, origins=(*origins, *own))
    return Opened(server, facts, page)


def stop_on_signals() -> asyncio.Event:
    """Event that is set by Ctrl-C or a request to end; the second one ends the process whatever it waits for.

    Errors that the event loop meets outside of any request, such as file descriptors that run out, are one line each.
    """
    stop, loop = asyncio.Event(), asyncio.get_running_loop()

    def end(number: int) -> None:
        stop.set()
        loop.remove_signal_handler(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end, number)
    loop.set_exception_handler(LoopErrors())
    return stop


class LoopErrors:
    """Reports errors of the system that no request waits for, at most one line each `REPORT_S`; others as asyncio does.

    Args:
        clock: Gives the time, seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._next_at = clock, -math.inf

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Takes what asyncio says of an error."""
        error = context.get("exception")
        if not isinstance(error, (OSError, MemoryError)):
            loop.default_exception_handler(context)
            return
        now = self._clock()
        if now < self._next_at:
            return
        self._next_at = now + REPORT_S
        advice = ""
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            advice = "; no more connections are accepted until some end: raise `ulimit -n`"
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        print(f"splatwire: error: {reason}{advice}", file=sys.stderr, flush=True)


def url_host(host: str) -> str:
    """A host as it stands in an address: numbers of IPv6 in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def _told_renewed(identity: "Identity") -> None:
    """Says by which fingerprint a server is known from here on."""
    print(f"the certificate was renewed; fingerprint: {identity.fingerprint}", file=sys.stderr, flush=True)
