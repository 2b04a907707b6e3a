"""HTTP server for the browser page: page, scripts and streams."""

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, runtime_checkable

from splatwire.errors import BitstreamError
from splatwire.transport.address import cannot_listen, check_port
from splatwire.transport.congestion.pacing import Pacer
from splatwire.transport.event_log import log_event
from splatwire.transport.http.messages import GrowingFile, Response, make_response, read_request
from splatwire.transport.http.proxies import IpNetwork, client_address
from splatwire.transport.protocol.admission import ConnectionSlots, Network, network_of, network_text

LOG = logging.getLogger(__name__)
MAX_HEAD_BYTES = 8192
CHUNK_BYTES = 1 << 16
"""Maximum number of body bytes passed to the kernel at once; no more is buffered for a slow client."""
TURN_S = 0.01
"""Duration of a turn of an HTTP response under a total rate limit, seconds. In its turn, a response sends at once the
bytes that the limit permits in this time. Datagrams wait meanwhile."""
MIN_TURN_BYTES = 1200
"""Minimum number of bytes that a response sends in one turn."""
YIELD_S = 0.002
"""Time that a response waits while datagrams are sent first, seconds."""
CLOSING_S = 5.0
"""Time without written data after which a client that has ended its sending side counts as disconnected, seconds."""
LINGER_S, LINGER_BYTES = 1.0, 1 << 22
"""Limits on reading the rest of a refused request, seconds and bytes. Unread bytes would reset the connection, and the
client could lose the response (RFC 9112, 9.6)."""
_BOUND_METHODS = ("_read_ready_cb", "_write_ready")
"""Attributes of asyncio's transports with bound methods of the same object."""
_LAST_TURNS = 5
"""Number of iterations of the event loop in which a closing server ends connections."""


@dataclass(frozen=True)
class PageLimits:
    """Limits of the page server on its clients. A network is an IPv4 address or a /64 prefix of IPv6.

    Attributes:
        slots: Maximum number of concurrent responses.
        per_network: Maximum number of concurrent responses to one network.
        waiting: Maximum number of connections whose request is incomplete.
        request_s: Maximum time from connection to the end of the request head, seconds.
        chunk_s: Maximum time to send the next `CHUNK_BYTES` of a response, seconds.
        slowest_bytes_s: Minimum average rate of a response, bytes per second; slower responses are aborted.
        grace_s: Time that every response may take in addition to its time at the minimum rate, seconds.
    """

    slots: int = 256
    per_network: int = 32
    waiting: int = 256
    request_s: float = 5.0
    chunk_s: float = 10.0
    slowest_bytes_s: float = 16_384.0
    grace_s: float = 30.0


@runtime_checkable
class Content(Protocol):
    """Typing protocol for the content of an HTTP server: maps the head of a request to a response."""

    @property
    def host(self) -> str:
        """Address that the server listens on."""

    def respond_now(self, head: bytes) -> Response:
        """Returns the HTTP response to a request, given its head with the final empty line."""

    def busy(self, head: bytes) -> Response:
        """Returns the HTTP response that refuses a request because the server is busy."""


@runtime_checkable
class SlowContent(Protocol):
    """Typing protocol for the content of an HTTP server, with responses that take time to prepare (converted files)."""

    async def respond(self, head: bytes) -> Response:
        """Returns the HTTP response to a request, and waits until its content is prepared.

        Args:
            head: Head of the HTTP request, up to and including the empty line.
        """


class PageServer:
    """HTTP server for the browser page. It is an asynchronous context manager and runs until the context ends.

    Args:
        content: Page, scripts and streams that the server offers; may be replaced later.
        port: TCP port; 0 selects a free port.
        limits: Limits on clients.
        proxies: Networks of trusted proxies, whose header `X-Forwarded-For` gives the address of the client.
        logged: True to log the responses.
        pacer: Pacer of the bytes of all responses together; None for no limit.

    Attributes:
        statuses: Number of responses by HTTP status code.
        num_responses: Number of requests that got a response.
        bytes_sent: Number of response bytes sent.

    Raises:
        InvalidValueError: If the port is in use, or not from 0 to 65535.
    """

    def __init__(
        self, content: Content, port: int = 0, limits: PageLimits | None = None, *, proxies: Sequence[IpNetwork] = (),
        logged: bool = True, pacer: Pacer | None = None,
    ) -> None:  # fmt: skip
        self.content = content
        self._proxies, self._logged = tuple(proxies), logged
        self._wanted, self._pacer = port, pacer
        self._turn = asyncio.Lock()
        self._limits = limits or PageLimits()
        self._server: asyncio.Server | None = None
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}
        self._waiting = ConnectionSlots(self._limits.waiting)
        self._slots = ConnectionSlots(self._limits.slots, self._limits.per_network)
        self.statuses: Counter[int] = Counter()
        self.num_responses = self.bytes_sent = 0

    async def __aenter__(self) -> "PageServer":
        host = self.content.host
        check_port(self._wanted)
        try:
            if host == "::" and socket.has_dualstack_ipv6():  # asyncio's own socket would accept IPv6 only, unlike UDP
                both = socket.create_server((host, self._wanted), family=socket.AF_INET6, dualstack_ipv6=True)
                self._server = await asyncio.start_server(self._begin, sock=both, limit=MAX_HEAD_BYTES)
            else:
                self._server = await asyncio.start_server(self._begin, host, self._wanted, limit=MAX_HEAD_BYTES)
        except OSError as error:
            raise cannot_listen("TCP", host, self._wanted, error) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
        # A connection that was accepted just before begins in one of the next turns of the event loop, and an aborted
        # one ends there.
        for _ in range(_LAST_TURNS):
            clients = list(self._clients)
            for client in clients:
                client.cancel()
            await asyncio.gather(*clients, return_exceptions=True)
            await asyncio.sleep(0)

    @property
    def port(self) -> int:
        """TCP port that the server listens on."""
        assert self._server is not None
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def url(self) -> str:
        """URL of the page."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.content.host, self.content.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def num_active(self) -> int:
        """Number of responses that are being sent."""
        return len(self._slots)

    def _begin(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Starts the task that serves a new connection."""
        # If asyncio created the task, it would log its cancellation at the server's exit as an error.
        client = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._clients[client] = writer
        client.add_done_callback(self._end)

    def _end(self, client: asyncio.Task[None]) -> None:
        transport = self._clients.pop(client).transport
        if not transport.is_closing():
            transport.abort()  # `close` would keep unread data as long as the client does not read
        asyncio.get_running_loop().call_soon(_release, transport)  # after the end of the connection, in the next turn

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer, limits = writer.get_extra_info("peername"), self._limits
        network = network_of(peer)
        try:
            self._waiting.take(network, writer.transport)
            try:
                async with asyncio.timeout(limits.request_s):
                    head = await _read_head(reader)
                    if head is None:
                        start = await reader.read(MAX_HEAD_BYTES)
                        await self._respond(b"", _too_long(start), network, reader, writer, close=False)
                        await _linger(reader, writer)
                        return
            finally:
                self._waiting.leave(network, writer.transport)
            if self._proxies:
                network = network_of(client_address(peer, head, self._proxies))
            if not self._slots.take(network, writer.transport):
                await self._respond(head, self.content.busy(head), network, reader, writer)
                return
            try:
                self.num_responses += 1
                content = self.content
                response = (
                    await content.respond(head) if isinstance(content, SlowContent) else content.respond_now(head)
                )
                refused = response.head[9:10] == b"4"
                await self._respond(head, response, network, reader, writer, close=not refused)
                if refused:
                    await _linger(reader, writer)
            finally:
                self._slots.leave(network, writer.transport)
        except (asyncio.IncompleteReadError, TimeoutError, OSError) as error:
            # The client disconnected, or sent no valid request. The reader refers to the error of a reset connection,
            # and its traceback to the reader.
            error.__traceback__ = None

    async def _respond(
        self, head: bytes, response: Response, network: Network, reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter, *, close: bool = True,
    ) -> None:  # fmt: skip
        """Sends a response to the client, and counts and logs the response."""
        loop, status = asyncio.get_running_loop(), int(response.head[9:12])
        began, sent, complete = loop.time(), _Count(), False
        self.statuses[status] += 1
        try:
            await self._send(response, reader, writer, sent)
            complete = True
            if close:
                writer.close()
        finally:
            if self._logged:
                seconds = round(loop.time() - began, 3)
                log_event(
                    LOG, logging.INFO, "response", client=network_text(network), **_request_line(head), status=status,
                    bytes=sent.num_bytes, seconds=seconds, complete=complete,
                )  # fmt: skip

    async def _send(
        self, response: Response, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, sent: "_Count"
    ) -> None:
        """Sends a response to the client, as fast as the client reads.

        Raises:
            TimeoutError: If the client reads too slowly.
            OSError: If the client disconnects.
        """
        limits, transport = self._limits, writer.transport
        transport.set_write_buffer_limits(high=0)  # makes `drain` wait until the kernel has everything
        connection = transport.get_extra_info("socket")
        if connection is not None and hasattr(socket, "TCP_NOTSENT_LOWAT"):  # else the kernel buffers megabytes
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, CHUNK_BYTES)
        await self._write(response.head, writer, sent)
        if not isinstance(response.body, GrowingFile):
            async with asyncio.timeout(limits.grace_s + len(response.body) / limits.slowest_bytes_s) as limit:
                await self._write(response.body, writer, sent, limit)
        else:
            await self._send_growing(response.body, reader, writer, sent)

    async def _send_growing(
        self, file: GrowingFile, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, sent: "_Count"
    ) -> None:
        """Sends a file while it grows, until it is complete or the client disconnects.

        A client that only ends its sending side gets the file as long as it grows and the client reads fast enough.
        Such a client and one that has disconnected differ only when something is sent.

        Raises:
            TimeoutError: If the client reads too slowly.
            OSError: If the client disconnects, or if it ends its sending side and the file does not grow for
                `CLOSING_S`.
        """
        num_pieces, waits_for_growth = 0, True

        async def write() -> None:
            nonlocal num_pieces, waits_for_growth
            async for piece in file.pieces():
                num_pieces, waits_for_growth = num_pieces + 1, False
                await self._write(piece, writer, sent)  # it limits the time
                waits_for_growth = True

        # While nothing is written, only reading shows that the client has disconnected.
        writing, leaving = asyncio.ensure_future(write()), asyncio.ensure_future(_discard(reader))
        try:
            await asyncio.wait((writing, leaving), return_when=asyncio.FIRST_COMPLETED)
            last = None
            while not writing.done():
                if leaving.exception() is not None or (waits_for_growth and num_pieces == last):
                    raise ConnectionResetError("the client has disconnected, or has ended its sending side")
                last = num_pieces
                await asyncio.wait((writing,), timeout=CLOSING_S)
            await writing
        finally:
            for task in (writing, leaving):
                task.cancel()
            await asyncio.gather(writing, leaving, return_exceptions=True)

    async def _write(
        self, data: bytes | memoryview, writer: asyncio.StreamWriter, sent: "_Count",
        limit: asyncio.Timeout | None = None,
    ) -> None:  # fmt: skip
        body, size = memoryview(data), CHUNK_BYTES
        if self._pacer is not None:
            size = min(max(int(self._pacer.rate * TURN_S), MIN_TURN_BYTES), CHUNK_BYTES)
        for at in range(0, len(body), size):
            piece = body[at : at + size]
            if self._pacer is not None:
                await self._pace(self._pacer, len(piece), limit)
            async with asyncio.timeout(self._limits.chunk_s):
                writer.write(piece)
                self.bytes_sent += len(piece)
                sent.num_bytes += len(piece)
                await writer.drain()

    async def _pace(self, pacer: Pacer, num_bytes: int, limit: asyncio.Timeout | None) -> None:
        """Waits until the rate limit of all responses permits more bytes, and counts these bytes.

        Args:
            pacer: Pacer of the bytes of all responses together.
            num_bytes: Number of bytes to send.
            limit: Time limit of the response, extended by the waiting time; None for no limit.
        """
        loop = asyncio.get_running_loop()
        began, end = loop.time(), None if limit is None else limit.when()
        if limit is not None:
            limit.reschedule(None)
        async with self._turn:  # responses take turns, and alternate with datagrams that wait
            await _wait_for_pacer(pacer)
            if pacer.datagrams_wait:
                before = pacer.next_at()
                await asyncio.sleep(YIELD_S)
                pacer.datagrams_wait &= pacer.next_at() > before  # else no datagram waits any more
                await _wait_for_pacer(pacer)
            if limit is not None and end is not None:
                limit.reschedule(end + loop.time() - began)
            pacer.sent(num_bytes, loop.time())


async def _read_head(reader: asyncio.StreamReader) -> bytes | None:
    """Returns the head of a request, with its final empty line; None if the head is too long.

    Raises:
        asyncio.IncompleteReadError: If the connection ends before the head does.
        OSError: If the connection fails.
    """
    try:
        return await reader.readuntil(b"\r\n\r\n")
    except asyncio.LimitOverrunError:
        return None


def _too_long(start: bytes) -> Response:
    """Returns the error response to a request whose head (request line and header fields) is too long.

    Args:
        start: Bytes of the head received so far. The status is 431 if they contain a complete request line, else 414.
    """
    line_ends = b"\r\n" in start
    return make_response("431 Request Header Fields Too Large" if line_ends else "414 URI Too Long")


async def _linger(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Ends the response. Then discards what the client still sends, until the client closes the connection."""
    writer.write_eof()
    with suppress(TimeoutError):
        async with asyncio.timeout(LINGER_S):
            await _discard(reader)


async def _discard(reader: asyncio.StreamReader) -> None:
    """Discards what a client sends, until the client closes the connection or has sent `LINGER_BYTES`.

    Raises:
        OSError: If the connection fails.
    """
    remaining = LINGER_BYTES
    while remaining > 0 and (data := await reader.read(CHUNK_BYTES)):
        remaining -= len(data)


def _release(transport: asyncio.WriteTransport) -> None:
    """Frees the memory of an ended connection.

    A transport of asyncio refers to itself by its bound methods. Without this function, only the garbage collector
    would free its memory and the memory of its reader. The garbage collector runs rarely in a process with many
    objects.
    """
    state = getattr(transport, "__dict__", {})  # none in other event loops
    for name in _BOUND_METHODS:
        state.pop(name, None)


async def _wait_for_pacer(pacer: Pacer) -> None:
    """Waits until a pacer (rate limiter) permits the next bytes."""
    loop = asyncio.get_running_loop()
    while (wait := pacer.next_at() - loop.time()) > 0:
        await asyncio.sleep(wait)


@dataclass
class _Count:
    """Number of bytes of a response sent so far, which the sending task increases."""

    num_bytes: int = 0


def _request_line(head: bytes) -> dict[str, str]:
    """Returns method and path of a request for the log; empty for an invalid request."""
    try:
        request = read_request(head)
    except BitstreamError:
        return {"method": "", "path": ""}
    return {"method": request.method, "path": request.target}
