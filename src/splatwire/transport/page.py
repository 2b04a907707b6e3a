"""The page of the receiver in a browser, served over plain HTTP: a few files and the streams, nothing else."""

import asyncio
import socket
from dataclasses import dataclass
from types import TracebackType

from splatwire.transport.address import cannot_listen
from splatwire.transport.admission import Places, network_of
from splatwire.transport.http_messages import Answer, Growing, make_answer
from splatwire.transport.page_content import PageContent

MOST_HEAD_BYTES = 8192
CHUNK_BYTES = 1 << 16
"""Of a body, what is handed to the system at once: all that is kept for a client that reads slowly."""


@dataclass(frozen=True)
class PageLimits:
    """What is spent on clients of the page.

    Attributes:
        places: Answers that are sent at once; at one more, the network with most of them loses its oldest, if the
            one that asks has fewer.
        per_network: The same of one network (`admission.network_of`).
        waiting: Connections at once whose request is not there yet; at one more, the network with most of them loses
            its oldest.
        request_s: Longest time from a connection to the end of its request's head.
        chunk_s: Longest time until the system takes the next part of an answer.
        slowest_bytes_s: An answer may take this many bytes a second, and `grace_s` more: below what a stream needs
            that anybody waits for.
        grace_s: See there.
    """

    places: int = 256
    per_network: int = 32
    waiting: int = 256
    request_s: float = 5.0
    chunk_s: float = 10.0
    slowest_bytes_s: float = 16_384.0
    grace_s: float = 30.0


class PageServer:
    """Serves the page until it is closed; use it as an asynchronous context.

    A browser lets a page open WebTransport sessions only if it came from this machine or over HTTPS; to a page from
    elsewhere the stream comes by HTTP.

    Args:
        content: What is served.
        port: TCP port; 0 lets the system choose.
        limits: What is spent on clients.

    Attributes:
        num_answers: Requests that were answered.
        bytes_sent: Bytes of answers that were handed to the system.

    Raises:
        InvalidValueError: If it is taken.
    """

    def __init__(self, content: PageContent, port: int = 0, limits: PageLimits | None = None) -> None:
        self._content = content
        self._wanted = port
        self._limits = limits or PageLimits()
        self._server: asyncio.Server | None = None
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}
        self._waiting = Places(self._limits.waiting)
        self._places = Places(self._limits.places, self._limits.per_network)
        self.num_answers = self.bytes_sent = 0

    async def __aenter__(self) -> "PageServer":
        host = self._content.host
        try:
            self._server = await asyncio.start_server(self._begin, host, self._wanted, limit=MOST_HEAD_BYTES)
        except OSError as error:
            raise cannot_listen("TCP", host, self._wanted, error) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
        clients = list(self._clients)
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        assert self._server is not None
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def url(self) -> str:
        """Address of the page."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self._content.host, self._content.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def _begin(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Takes a connection. Its task is ours, not asyncio's, which would print that it was cancelled."""
        client = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._clients[client] = writer
        client.add_done_callback(self._end)

    def _end(self, client: asyncio.Task[None]) -> None:
        writer = self._clients.pop(client)
        if not writer.is_closing():
            writer.transport.abort()  # closing would keep what was not read, for as long as nobody reads it

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        network, limits = network_of(writer.get_extra_info("peername")), self._limits
        try:
            self._waiting.take(network, writer.transport)
            try:
                async with asyncio.timeout(limits.request_s):
                    head = await reader.readuntil(b"\r\n\r\n")
            finally:
                self._waiting.leave(network, writer.transport)
            if not self._places.take(network, writer.transport):
                await self._send(make_answer("503 Service Unavailable", headers="Retry-After: 1\r\n"), writer)
                return
            try:
                self.num_answers += 1
                await self._send(self._content.answer(head), writer)
            finally:
                self._places.leave(network, writer.transport)
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
            pass  # whoever it was wanted no page

    async def _send(self, answer: Answer, writer: asyncio.StreamWriter) -> None:
        """Hands an answer to the system as fast as it is read there.

        Raises:
            TimeoutError: If it is read too slowly.
        """
        limits, transport = self._limits, writer.transport
        transport.set_write_buffer_limits(high=0)  # so that `drain` waits until the system has taken everything
        connection = transport.get_extra_info("socket")
        if connection is not None and hasattr(socket, "TCP_NOTSENT_LOWAT"):  # else it buffers megabytes of its own
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, CHUNK_BYTES)
        await self._write(answer.head, writer)
        if not isinstance(answer.body, Growing):
            async with asyncio.timeout(limits.grace_s + len(answer.body) / limits.slowest_bytes_s):
                await self._write(answer.body, writer)
        else:
            async for piece in answer.body.pieces():
                await self._write(piece, writer)
        writer.close()

    async def _write(self, data: bytes | memoryview, writer: asyncio.StreamWriter) -> None:
        body = memoryview(data)
        for at in range(0, len(body), CHUNK_BYTES):
            async with asyncio.timeout(self._limits.chunk_s):
                piece = body[at : at + CHUNK_BYTES]
                writer.write(piece)
                self.bytes_sent += len(piece)
                await writer.drain()
