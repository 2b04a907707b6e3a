"""Hostile QUIC clients end only their own connection."""

import asyncio
import contextlib
import gc
import logging
import random
import socket
import ssl
import weakref
from collections.abc import Callable
from typing import Any

import pytest

from splatwire.transport import ReceiverOptions, ServerLimits
from splatwire.transport.protocol.messages import Feedback, ParityRange, Request, Welcome
from splatwire.transport.protocol.wire import (
    DATA,
    INIT_SYMBOL,
    WELCOME,
    encode,
    encode_data,
    encode_symbol,
    message_kind,
)

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.h3.connection import H3Connection
from aioquic.h3.events import HeadersReceived
from aioquic.quic import events
from aioquic.quic.connection import QuicConnection

from splatwire.errors import BitstreamError
from splatwire.transport.quic import input_budget
from splatwire.transport.quic import server as quic_server
from splatwire.transport.quic.common import (
    ALPN,
    WEBTRANSPORT_PATH,
    WINDOW_BYTES,
    MessageReader,
    QuicLimits,
    configuration,
    length_prefixed,
)
from splatwire.transport.quic.handlers import MAX_PENDING_DATAGRAMS, MAX_PENDING_MESSAGES
from splatwire.transport.quic.page import Page, open_quic_server
from splatwire.transport.quic.server import MIN_MALFORMED, RETRY_HANDSHAKES
from transport.test_quic import IDENTITY, OTHER, PROGRAMS, fetch, run, serving

pytestmark = pytest.mark.slow


class Client(QuicConnectionProtocol):
    """A client with direct access to all layers."""

    def __init__(self, quic: QuicConnection) -> None:
        super().__init__(quic)
        self.quic = quic
        self.ended: events.ConnectionTerminated | None = None
        self.http: H3Connection | None = None
        self.statuses: list[int] = []
        self.got = 0
        self.frames: list[bytes] = []
        self.stream: int | None = None
        self._reader = MessageReader()

    def quic_event_received(self, event: events.QuicEvent) -> None:
        if isinstance(event, events.ConnectionTerminated):
            self.ended = event
        self.got += isinstance(event, (events.StreamDataReceived, events.DatagramFrameReceived))
        if isinstance(event, events.StreamDataReceived) and event.stream_id == self.stream:
            self.frames += self._reader.feed(event.data)
            return  # aioquic would treat data on such a stream as HTTP
        for http_event in self.http.handle_event(event) if self.http else []:
            if isinstance(http_event, HeadersReceived):
                self.statuses.append(int(dict(http_event.headers)[b":status"]))

    def connect_to(self, path: str = WEBTRANSPORT_PATH, **changed: str) -> int:
        """Requests a WebTransport session."""
        fields = {"method": "CONNECT", "scheme": "https", "authority": "localhost", "path": path,
                  "protocol": "webtransport", **changed}  # fmt: skip
        stream = self.quic.get_next_available_stream_id()
        headers = [(f":{key}".encode(), value.encode()) for key, value in fields.items() if key != "origin"]
        headers += [(b"origin", changed["origin"].encode())] if "origin" in changed else []
        self.http.send_headers(stream, headers)
        self.transmit()
        return stream


async def connected(port: int, alpn: str) -> Client:
    settings = configuration(is_client=True, alpn=[alpn], idle_s=10.0)
    settings.verify_mode, settings.server_name = ssl.CERT_NONE, "localhost"
    client = Client(QuicConnection(configuration=settings))
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: client, local_addr=("127.0.0.1", 0))
    client.connect(("127.0.0.1", port))
    await client.wait_connected()
    if alpn == "h3":
        client.http = H3Connection(client.quic, enable_webtransport=True)
    return client


async def until(true: Callable[[], Any], seconds: float = 240.0) -> None:
    end = asyncio.get_running_loop().time() + seconds
    while not true():
        assert asyncio.get_running_loop().time() < end, "no answer arrived"
        await asyncio.sleep(0.01)


async def still_serves(port: int) -> None:
    assert (await fetch(port, ReceiverOptions(name="other"))).stream() == OTHER


async def close_client(*clients: Client) -> None:
    for client in clients:
        client.close()
        client._transport.close()
    await asyncio.sleep(0.02)


@pytest.mark.parametrize(
    "malice",
    [
        lambda quic: quic.send_stream_data(0, b"\0\0rest"),
        lambda quic: quic.send_stream_data(0, b"\xff\xff" + bytes(2000)),
        lambda quic: quic.send_stream_data(4, length_prefixed(encode(Request(1, bytes(16), "")))),
        lambda quic: quic.send_stream_data(2, b"a stream of one direction"),
        lambda quic: (quic.send_stream_data(0, b"\5"), quic.reset_stream(0, 7)),
    ],
)
def test_malformed_streams_end_their_connection_only(malice):
    async def work() -> None:
        async with serving() as server:
            client = await connected(server.port, ALPN)
            malice(client.quic)
            client.transmit()
            await until(lambda: client.ended)
            assert server.num_malformed == 1
            await still_serves(server.port)
            await close_client(client)

    run(work())


def test_many_malformed_connections_give_one_log_line(caplog):
    async def work() -> None:
        async with serving() as server:
            for _ in range(MIN_MALFORMED + 2):
                client = await connected(server.port, ALPN)
                client.quic.send_stream_data(0, b"\0\0rest")
                client.transmit()
                await until(lambda client=client: client.ended)
                await close_client(client)

    run(work())
    (line,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert line == f"malformed connections ended count={MIN_MALFORMED}"


def test_thousands_of_invalid_frames_are_ignored(monkeypatch: pytest.MonkeyPatch):
    """Random and oversized DATAGRAM frames, feedback of other sessions, and server-only frames."""
    for limit in ("MAX_SHARE", "MAX_NETWORK_SHARE"):  # otherwise the server drops most of so many datagrams
        monkeypatch.setattr(input_budget, limit, 1.0)

    async def work() -> None:
        rng = random.Random(1)
        async with serving() as server:
            client = await connected(server.port, ALPN)
            most = 2**32 - 1
            frames = [lambda: rng.randbytes(rng.randrange(1, 1180)), lambda: bytes([0x10 | DATA]) + rng.randbytes(50),
                      lambda: encode(Feedback(rng.getrandbits(32), most, most, 0, most, (most,) * 250)),
                      lambda: bytes([0x10 | rng.randrange(16)]) + rng.randbytes(rng.randrange(1200))]  # fmt: skip
            for _ in range(100):
                for _ in range(20):
                    client.quic.send_datagram_frame(rng.choice(frames)()[:1180])
                    client.quic.send_stream_data(0, length_prefixed(rng.choice(frames)()[:1180]))
                client.transmit()
                await asyncio.sleep(0)
            await until(lambda: server.core.num_rejected > 2000)
            assert client.ended is None
            assert client.got == 0
            assert server.core.num_transfers == 0
            await still_serves(server.port)
            await close_client(client)

    run(work())


@pytest.mark.parametrize("busy", [False, True])
def test_unvalidated_address_gets_few_bytes(busy):
    """Traffic to a spoofed victim: three times its bytes per greeting, one small answer under load."""

    async def work() -> None:
        async with serving() as server:
            if busy:
                server.handshaking |= {object() for _ in range(RETRY_HANDSHAKES)}
            settings = configuration(is_client=True, alpn=[ALPN], idle_s=5.0)
            settings.server_name = "localhost"
            quic = QuicConnection(configuration=settings)
            quic.connect(("127.0.0.1", server.port), now=0.0)
            hello = [data for data, _ in quic.datagrams_to_send(now=0.0)]
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as victim:
                victim.setblocking(False)
                for data in hello:
                    victim.sendto(data, ("127.0.0.1", server.port))
                first = asyncio.get_running_loop().sock_recv(victim, 2048)
                answers = [await asyncio.wait_for(first, 60)]
                assert len(server.connections) == (not busy)
                # Time passes: QUIC sends its probes, and then ends the connection.
                for connection in list(server.connections):
                    for _ in range(10):
                        if connection._timer is not None:
                            connection._timer.cancel()
                            connection._handle_timer()
                while True:
                    try:
                        answers.append(victim.recv(2048))
                    except BlockingIOError:
                        break
            assert sum(map(len, answers)) <= (0.2 if busy else 3) * sum(map(len, hello))
            if busy:
                await still_serves(server.port)

    run(work())


@pytest.mark.parametrize("others", [4, 24])
def test_many_networks_of_one_provider_yield_to_others(others: int, monkeypatch: pytest.MonkeyPatch):
    """Clients of many networks in one wide network occupy all connections, and are displaced by others.

    Without that, 24 of them would block every new handshake.
    """
    known: dict[Any, Any] = {}
    networks = iter([*((("wide",), ("wide", n)) for n in range(others)), (("other",), ("other", 1))])
    monkeypatch.setattr(
        quic_server, "network_of", lambda address: known.get(address) or known.setdefault(address, next(networks))
    )
    monkeypatch.setattr(quic_server, "REQUEST_TIMEOUT_S", 60.0)

    async def work() -> None:
        async with serving() as server:
            server.limits = QuicLimits(connections=others)
            held = [await connected(server.port, ALPN) for _ in range(others)]
            server.limits = QuicLimits(connections=4)
            await still_serves(server.port)
            await until(lambda: sum(client.ended is not None for client in held) == others - 3)
            await close_client(*held)

    run(work())


def request(nonce: int = 1) -> bytes:
    return encode(Request(nonce, bytes(16), "other"))


def test_datagram_request_before_the_stream_is_answered_on_the_stream():
    async def work() -> None:
        async with serving() as server:
            client = await connected(server.port, "h3")
            session = client.connect_to()
            await until(lambda: client.statuses == [200])
            client.http.send_datagram(session, request())
            client.transmit()
            await until(lambda: server.core.num_served)
            client.stream = client.http.create_webtransport_stream(session)
            client.quic.send_stream_data(client.stream, length_prefixed(request()))
            client.transmit()
            await until(lambda: client.frames)
            assert message_kind(client.frames[0]) == WELCOME
            assert server.core.num_served == 1
            assert server.num_malformed == 0
            await close_client(client)

    run(work())


def test_session_without_a_stream_buffers_little():
    async def work() -> None:
        async with serving() as server:
            client = await connected(server.port, "h3")
            client.connect_to()
            await until(lambda: client.statuses == [200])
            (connection,) = server.connections
            for _ in range(MAX_PENDING_MESSAGES):
                connection._handler._client.send(request())
            assert server.num_malformed == 0
            connection._handler._client.send(request())
            assert server.num_malformed == 1
            await until(lambda: client.ended)
            await close_client(client)

    run(work())


def test_a_client_that_acknowledges_nothing_fills_no_memory():
    """A client may confirm datagrams to the protocol core that it never acknowledges to QUIC."""

    async def work() -> None:
        async with serving() as server:
            client = await connected(server.port, ALPN)
            client.quic.send_stream_data(0, length_prefixed(b"\0"))
            client.transmit()
            await until(lambda: server.connections and next(iter(server.connections))._handler.has_request)
            (connection,) = server.connections
            on_server = connection._handler._client
            for number in range(2 * MAX_PENDING_DATAGRAMS):
                on_server.send(encode_data(1, number, number, bytes(1000)))
            assert len(connection.quic._datagrams_pending) == MAX_PENDING_DATAGRAMS
            head = encode(
                Welcome(1, 1, 1, WINDOW_BYTES, bytes(32), 1000, 1, 1000, 0, (ParityRange(1, 0, 0),), b"", True, False)
            )
            symbol = encode_symbol(INIT_SYMBOL, 1, 0, 0, 0, bytes(1000))
            on_server.send(head)
            for _ in range(2 * WINDOW_BYTES // len(symbol)):  # one head may wait, and a second one
                on_server.send(symbol)
            assert server.num_malformed == 0
            for _ in range(2 * WINDOW_BYTES // len(symbol)):
                on_server.send(symbol)
            assert server.num_malformed
            assert not server.connections
            await close_client(client)

    run(work())


def test_webtransport_answers_only_its_own_path():
    async def work() -> None:
        async with serving(quic=QuicLimits(origins=("https://here.example",))) as server:
            client = await connected(server.port, "h3")
            client.connect_to("/elsewhere", origin="https://here.example")
            client.connect_to(method="GET", protocol="other", origin="https://here.example")
            client.connect_to(origin="https://there.example")
            client.connect_to(WEBTRANSPORT_PATH + "?x=1", origin="https://here.example")
            client.connect_to(origin="https://here.example")
            await until(lambda: len(client.statuses) == 5)
            assert client.statuses == [404, 405, 403, 200, 429]
            assert client.ended is None
            await close_client(client)

    run(work())


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [("http://localhost:5173", True), ("https://evil.example", False), ("null", False), ("https://a.org", False)],
)
def test_pages_of_other_sites_open_no_session_with_a_server_on_loopback(origin, allowed):
    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            opened = await open_quic_server(PROGRAMS, "127.0.0.1", 0, lambda: IDENTITY, ServerLimits(), stack)
            client = await connected(opened.server.port, "h3")
            client.connect_to(origin=origin)
            await until(lambda: len(client.statuses) == 1)
            assert client.statuses == [200 if allowed else 403]
            await close_client(client)
            for host, page, others in (
                ("0.0.0.0", None, True), ("127.0.0.1", Page(0, "https://a.org"), True), ("127.0.0.1", Page(0), False)
            ):  # fmt: skip
                more = await open_quic_server(PROGRAMS, host, 0, lambda: IDENTITY, ServerLimits(), stack, page=page)
                assert more.server.limits.allows_origin(b"https://evil.example") == others

    run(work())


def test_webtransport_streams_outside_the_session_end_the_connection():
    async def work() -> None:
        async with serving() as server:
            for kind in ("no session", "two streams", "broken", "of one direction"):
                client = await connected(server.port, "h3")
                session = 0 if kind == "no session" else client.connect_to()
                stream = client.http.create_webtransport_stream(session, is_unidirectional=kind == "of one direction")
                client.quic.send_stream_data(stream, b"\0\0" if kind == "broken" else b"\5")
                if kind == "two streams":
                    other = client.http.create_webtransport_stream(session)
                    client.quic.send_stream_data(other, b"\5")
                client.transmit()
                await until(lambda client=client: client.ended)
                await close_client(client)
            assert server.num_malformed == 4
            await still_serves(server.port)

    run(work())


def test_broken_http_ends_the_connection():
    async def work() -> None:
        async with serving() as server:
            for stream, data in (
                (0, b"\x04\x02\x00\x00"),
                (2, b"\x00\x00\x05hello"),
                (2, b"\x00\x04\x04\xff\xff\xff\xff"),
            ):
                client = await connected(server.port, "h3")
                client.quic.send_stream_data(stream, data, end_stream=True)
                client.transmit()
                await until(lambda client=client: client.ended)
                await close_client(client)
            await still_serves(server.port)

    run(work())


def test_frames_are_reassembled_from_any_chunks():
    rng = random.Random(3)
    frames = [rng.randbytes(rng.randrange(1, 1200)) for _ in range(50)]
    data, reader, found = b"".join(map(length_prefixed, frames)), MessageReader(), []
    while data:
        cut = rng.randrange(1, 900)
        found += reader.feed(data[:cut])
        data = data[cut:]
    assert found == frames
    with pytest.raises(BitstreamError, match="1201 bytes"):
        reader.feed((1201).to_bytes(2, "little"))


@pytest.mark.parametrize("alpn", [ALPN, "h3"])
def test_ended_connections_free_their_memory_without_the_garbage_collector(alpn: str) -> None:
    async def work() -> None:
        async with serving() as server:
            clients = [await connected(server.port, alpn) for _ in range(5)]
            await until(lambda: len(server.connections) == 5)
            states = [weakref.ref(connection.quic) for connection in server.connections]
            others = [weakref.ref(connection) for connection in server.connections]
            await close_client(*clients)
            await until(lambda: not server._endpoint._protocols)
            await until(lambda: not any(state() for state in (*states, *others)))

    gc.collect()
    gc.disable()
    try:
        run(work())
    finally:
        gc.enable()
