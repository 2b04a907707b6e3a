"""Common code of the subcommands that serve streams over UDP or QUIC, with an optional web page."""

import asyncio
import contextlib
import errno
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from splatwire.cli._loop_signals import LoopSignals
from splatwire.cli._operations import log_error, monitoring_address, open_monitoring, start_log
from splatwire.cli._options import Listening
from splatwire.cli._output import print_json
from splatwire.errors import InvalidValueError
from splatwire.transport import ServedStream, ServerLimits
from splatwire.transport.access import Access
from splatwire.transport.address import check_port
from splatwire.transport.http.origins import parse_origin
from splatwire.transport.http.proxies import parse_networks
from splatwire.transport.quic.installed import need_aioquic
from splatwire.transport.running_server import RunningServer
from splatwire.transport.udp import UdpServer

MIN_TOTAL_RATE = 0.15
"""Minimum of `--total-rate`, megabits per second. One response over HTTP needs 0.13, and at lower rates it may delay
datagrams until their clients give up."""
REPORT_S = 5.0
"""Minimum interval between two reports of errors outside of any request, seconds."""


def check_listening(listening: Listening) -> None:
    """Checks the command-line options of a server (ports, certificate, rates) before any scene is read.

    Raises:
        InvalidValueError: If a port or the rate is out of range, or a certificate was given for plain UDP.
    """
    check_port(listening.port)
    check_port(listening.page or 0)
    if not listening.over_quic and (listening.certificate or listening.key):
        raise InvalidValueError("--certificate and --key are for --quic")
    if listening.public_url is not None and listening.page is None:
        raise InvalidValueError("--public-url is for --page")
    public_origin(listening)
    if listening.proxy and listening.page is None:
        raise InvalidValueError("--proxy is for --page")
    parse_networks(listening.proxy)
    if listening.monitor is not None:
        monitoring_address(listening.monitor)
    if min(listening.clients, listening.clients_per_address) < 1:
        raise InvalidValueError("--clients and --clients-per-address are at least 1")
    if listening.rate is not None and not 0 < listening.rate <= 100_000:
        raise InvalidValueError(f"a rate is above 0 and at most 100000 megabits per second, {listening.rate} is not")
    if listening.total_rate is not None and not MIN_TOTAL_RATE <= listening.total_rate <= 1_000_000:
        raise InvalidValueError(
            f"--total-rate is {MIN_TOTAL_RATE} to 1000000 megabits per second, {listening.total_rate} is not: "
            "transfers would not end"
        )


def public_origin(listening: Listening) -> str | None:
    """Web origin (scheme, host and port) of `public_url`; None if the option is not set.

    Raises:
        InvalidValueError: If the option is not the URL of a page at the root of a host.
    """
    return None if listening.public_url is None else parse_origin(listening.public_url)


def print_ready(listening: Listening, port: int, facts: "Mapping[str, str]", content: str, **more: Any) -> None:
    """Prints the addresses of a server that is ready, and the information that clients need to connect.

    Args:
        listening: Options of the server.
        port: Port on which the server receives.
        facts: Names and values to print, such as the fingerprint of the certificate.
        content: Description of what is served.
        **more: Further values, for JSON output only.
    """
    if listening.json:
        print_json({"host": listening.host, "port": port, **more, **facts})
    else:
        print(f"{content} on {'quic' if listening.over_quic else 'udp'}://{url_host(listening.host)}:{port}")
        for name, value in facts.items():
            print(f"{name}: {value}")
    sys.stdout.flush()


async def open_server(
    streams: Mapping[str, ServedStream], listening: Listening, limits: ServerLimits,
    stack: contextlib.AsyncExitStack, *, origins: tuple[str, ...] = (), live: str | None = None,
    access: Access | None = None,
) -> RunningServer:  # fmt: skip
    """Starts a server, and the web server of the viewer page if requested.

    Args:
        streams: Streams by name.
        listening: Options of the server: address, port and transport.
        limits: Limits of connections and resources for clients.
        stack: Exit stack that closes the server.
        origins: Web origins whose pages may open sessions; if empty, all, but on a loopback address without
            `--public-url` only pages of this machine, and clients that are no pages.
        live: Name of a live stream, which the page shows.
        access: Access rules for private scenes; None if all scenes are public.
    """
    start_log(listening, stack)
    asyncio.get_running_loop().set_exception_handler(LoopErrors(report=log_error))
    if listening.over_quic:
        need_aioquic()
        from splatwire.cli import _quic  # imports aioquic, which servers over UDP do without

        running = await _quic.open_server(
            streams, listening, limits, stack, origins, live, public_origin(listening), access
        )
    else:
        plain = UdpServer(streams, listening.host, listening.port, limits=limits)
        stack.callback(plain.close)
        running = RunningServer(plain, {})
    running.facts.update(await open_monitoring(running, listening, stack))
    return running


@contextlib.contextmanager
def stop_on_signals() -> Iterator[asyncio.Event]:
    """Context with an event that is set by SIGINT (Ctrl-C) or SIGTERM.

    The first signal also restores the previous action of this signal, so that a second one ends the command
    immediately. `LoopErrors` becomes the event loop's handler of errors that belong to no request.

    Yields:
        The event.
    """
    stop = asyncio.Event()

    def end(number: int) -> None:
        stop.set()
        signals.restore(number)

    signals = LoopSignals(end)
    asyncio.get_running_loop().set_exception_handler(LoopErrors())
    try:
        yield stop
    finally:
        signals.restore()


@contextlib.contextmanager
def reload_on_hangup() -> Iterator[asyncio.Event]:
    """Context with an event that is set by SIGHUP, unless standard input is a terminal.

    Yields:
        The event.
    """
    # With a terminal, SIGHUP means that the terminal was closed, and ends the process.
    reload, numbers = asyncio.Event(), list[int]()
    if hasattr(signal, "SIGHUP") and not (sys.stdin is not None and sys.stdin.isatty()):
        numbers.append(signal.SIGHUP)
    signals = LoopSignals(lambda number: reload.set(), numbers, ignored=True)
    try:
        yield reload
    finally:
        signals.restore()


async def first_event(first: asyncio.Event, second: asyncio.Event) -> asyncio.Event:
    """Waits until one of two events is set and returns this event."""
    waits = [asyncio.ensure_future(event.wait()) for event in (first, second)]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
    return first if first.is_set() else second


class LoopErrors:
    """Handler of errors in the event loop that belong to no request; limits how often system errors are printed.

    Args:
        clock: Returns the current time, seconds.
        report: Function that prints an error message; None to print on standard error.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, report: Callable[[str], None] | None = None
    ) -> None:
        self._clock, self._next_at, self._report = clock, -math.inf, report or _print_error

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handles an error of the event loop.

        System errors and memory errors are printed as one line, at most one per `REPORT_S` seconds. Other errors are
        passed to the default handler.

        Args:
            loop: The event loop.
            context: Description of the error, as for `loop.call_exception_handler`.
        """
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
        self._report(f"{reason}{advice}")


def _print_error(text: str) -> None:
    print(f"splatwire: error: {text}", file=sys.stderr, flush=True)


def url_host(host: str) -> str:
    """Formats a host for a URL: IPv6 addresses are enclosed in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host
