"""QUIC clients with excessive streams: data, endless frames, and resets at any time."""

import asyncio
import random
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.buffer import encode_uint_var
from aioquic.quic.connection import stream_is_unidirectional
from aioquic.tls import Epoch

from splatwire.transport.quic import server as quic_server
from splatwire.transport.quic.common import ALPN, MAX_OUTSIDE_BYTES, MAX_STREAMS, MAX_UNREAD_BYTES, length_prefixed
from transport.test_quic import run, serving
from transport.test_quic_hostile import Client, close_client, connected, request, still_serves, until

pytestmark = pytest.mark.slow

HEADERS, DATA, SETTINGS, UNKNOWN, WEBTRANSPORT = 1, 0, 4, 0x21, 0x41
CONTROL, PUSH, ENCODER, DECODER = range(4)
ENDLESS = encode_uint_var(1 << 40)


@pytest.fixture
def failures() -> Iterator[list[Any]]:
    """Unexpected exceptions of the event loop; none may occur."""
    problems: list[Any] = []
    yield problems
    assert problems == []


def watch(failures: list[Any]) -> None:
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: failures.append(context))


async def pour(client: Client, stream: int, pieces: int = 400, size: int = 1000) -> int:
    """Sends to a stream until the server ends the connection; returns the bytes sent by then."""
    sent = 0
    for _ in range(pieces):
        if client.ended:
            break
        client.quic.send_stream_data(stream, bytes(size))
        client.transmit()
        sent += size
        await asyncio.sleep(0.002)
    return sent


@pytest.mark.parametrize(
    ("stream", "begins"),
    [
        (4, encode_uint_var(HEADERS) + ENDLESS), (4, encode_uint_var(UNKNOWN) + ENDLESS),
        (0, encode_uint_var(DATA) + ENDLESS), (0, encode_uint_var(UNKNOWN) + ENDLESS),
        (0, encode_uint_var(HEADERS) + ENDLESS),
        (14, encode_uint_var(UNKNOWN)), (6, b""), (2, encode_uint_var(UNKNOWN) + ENDLESS),
    ],
    ids=["HEADERS", "unknown frame", "DATA of the session", "unknown frame of the session", "trailers of the session",
         "unknown stream", "QPACK", "unknown frame of control"],
)  # fmt: skip
def test_data_outside_the_session_stream_is_bounded(stream: int, begins: bytes, failures: list[Any]):
    """Each of these was buffered without limit; a HEADERS frame was parsed again with every datagram."""

    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, "h3")
            client.connect_to()
            await until(lambda: client.statuses == [200])
            (connection,) = server.connections
            client.quic.send_stream_data(stream, begins)
            await pour(client, stream)
            await until(lambda: client.ended)
            assert connection._num_bytes_read < MAX_OUTSIDE_BYTES + 4000
            await still_serves(server.port)
            await close_client(client)

    run(work())


@pytest.mark.parametrize("alpn", [ALPN, "h3"])
def test_data_buffered_behind_a_gap_is_bounded(alpn: str, failures: list[Any]):
    """The first byte of a stream never arrives, and all later ones would be buffered."""

    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, alpn)
            (connection,) = server.connections
            limit = connection.quic._local_max_data  # an ended connection releases it
            client.quic.send_stream_data(0, bytes(1000))
            client.quic._streams[0].sender._pending.subtract(0, 1)
            await pour(client, 0)
            await until(lambda: client.ended)
            assert limit.used < MAX_UNREAD_BYTES + 4000
            await still_serves(server.port)
            await close_client(client)

    run(work())


def test_handshake_data_buffered_behind_a_gap_are_bounded(failures: list[Any]):
    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, ALPN)
            (connection,) = server.connections
            receiver = connection.quic._crypto_streams[Epoch.ONE_RTT].receiver  # an ended connection releases it
            sender = client.quic._crypto_streams[Epoch.ONE_RTT].sender
            sender.write(bytes(4 * MAX_UNREAD_BYTES))
            sender._pending.subtract(0, 1)

            def has_ended() -> bool:
                client.transmit()
                return client.ended is not None

            await until(has_ended)
            assert len(receiver._buffer) < MAX_UNREAD_BYTES + 4000
            assert server.num_malformed == 1
            await still_serves(server.port)
            await close_client(client)

    run(work())


def test_packets_that_a_client_never_acknowledges_are_bounded(
    failures: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server keeps the number of each packet of acknowledgements until the client acknowledges it."""
    monkeypatch.setattr(quic_server, "MAX_UNACKNOWLEDGED", 50)

    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, ALPN)
            client.quic._loss._cc.congestion_window = 1 << 40
            monkeypatch.setattr(client, "datagram_received", lambda *_: None)
            for _ in range(1000):
                client.quic.send_datagram_frame(b"noise")
                client.transmit()
                await asyncio.sleep(0)
                if server.num_malformed:
                    break
            assert server.num_malformed == 1
            assert not server.connections
            await still_serves(server.port)
            await close_client(client)

    run(work())


def test_opened_and_ended_streams_are_counted(failures: list[Any]):
    """Requests without bytes: none was complete or answered, and each allowed the next."""

    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, "h3")
            assert client.quic._remote_max_streams_bidi == client.quic._remote_max_streams_uni == MAX_STREAMS
            (connection,) = server.connections
            limit = connection.quic._local_max_streams_bidi  # an ended connection releases it
            for _ in range(2000):
                if client.ended:
                    break
                client.quic.send_stream_data(client.quic.get_next_available_stream_id(), b"", end_stream=True)
                client.transmit()
                await asyncio.sleep(0.002)
            await until(lambda: client.ended)
            assert limit.used <= MAX_OUTSIDE_BYTES // 16 + 64
            await still_serves(server.port)
            await close_client(client)

    run(work())


def abort_streams(client: Client, kind: str, session: int) -> None:
    """Sequence of resets and stops that no browser sends, in one flight."""
    quic, http = client.quic, client.http
    trailers = [(b"x", b"y")]
    match kind:
        case "trailers after 404":
            http.send_headers(client.connect_to("/elsewhere"), trailers, end_stream=True)
        case "trailers after 429":
            http.send_headers(client.connect_to(), trailers, end_stream=True)
        case "trailers after 200":
            http.send_headers(session, trailers)
        case "a request that is stopped":
            transmit, client.transmit = client.transmit, lambda: None
            quic.stop_stream(client.connect_to("/elsewhere"), 1)
            client.transmit = transmit
        case "a request that is reset":
            transmit, client.transmit = client.transmit, lambda: None
            quic.reset_stream(client.connect_to("/elsewhere"), 1)
            client.transmit = transmit
        case "the session's request stopped":
            quic.stop_stream(session, 1)
            http.send_datagram(session, request())
        case "the session's stream stopped" | "the session's stream stopped, then a datagram":
            stream = http.create_webtransport_stream(session)
            quic.send_stream_data(stream, length_prefixed(request()))
            quic.stop_stream(stream, 1)
            if kind.endswith("datagram"):
                http.send_datagram(session, request(2))
        case "our streams stopped":
            for stream in (3, 7, 11):
                quic._get_or_create_stream(5, stream).receiver.stop(1)
            transmit, client.transmit = client.transmit, lambda: None
            client.connect_to("/elsewhere")
            client.transmit = transmit
        case "everything reset":
            quic.send_stream_data(http.create_webtransport_stream(session), length_prefixed(request()))
            for stream in [*quic._streams]:
                if stream % 2 == 0:
                    quic.reset_stream(stream, 1)
    client.transmit()


@pytest.mark.parametrize(
    "kind",
    [
        "trailers after 404", "trailers after 429", "trailers after 200", "a request that is stopped",
        "a request that is reset", "the session's request stopped", "the session's stream stopped",
        "the session's stream stopped, then a datagram", "our streams stopped", "everything reset",
    ],
)  # fmt: skip
def test_aborted_streams_log_no_internal_error(kind: str, failures: list[Any]):
    async def work() -> None:
        watch(failures)
        async with serving() as server:
            client = await connected(server.port, "h3")
            session = client.connect_to()
            await until(lambda: client.statuses == [200])
            client.quic_event_received = lambda event: None  # otherwise it may answer on streams that it has reset
            abort_streams(client, kind, session)
            await still_serves(server.port)
            assert len(server.connections) <= 2
            assert server.core.num_failed == 0
            await close_client(client)

    run(work())


def noise(rng: random.Random) -> bytes:
    """Frames of HTTP/3 that are valid, invalid or incomplete."""
    frame = rng.choice((HEADERS, DATA, SETTINGS, UNKNOWN, WEBTRANSPORT, 3, 5, 7, 0xD, rng.randrange(1 << 14)))
    body = rng.choice((rng.randbytes(rng.randrange(40)), b"\0\0\xd1\xd7\x50\x01a", b"\2\0\x80", b"\0\0", b""))
    size = rng.choice((len(body), len(body), rng.randrange(100), rng.randrange(1 << 30)))
    return encode_uint_var(frame) + encode_uint_var(size) + body


@pytest.mark.parametrize("seed", range(3))
def test_noise_on_streams_ends_at_most_one_connection(seed: int, failures: list[Any]):
    """Random frames, resets, STOP_SENDING and ends on streams of both directions, over hundreds of connections."""
    rng = random.Random(seed)

    async def work() -> None:
        watch(failures)
        async with serving() as server:
            for _ in range(40):
                client = await connected(server.port, "h3")
                client.quic_event_received = lambda event: None  # otherwise it answers on streams that it has ended
                session = client.connect_to() if rng.random() < 0.7 else 0
                for _ in range(rng.randrange(1, 60)):
                    stream = rng.choice((0, 4, 8, 2, 6, 10, 14, 18))
                    said = rng.choice((noise(rng), bytes([rng.randrange(5)]), encode_uint_var(0x54) + b"\0", b""))
                    try:
                        match rng.randrange(12):
                            case 0:
                                client.quic.reset_stream(stream, 1)
                            case 1 if not stream_is_unidirectional(stream):
                                client.quic.stop_stream(stream, 1)
                            case 2:
                                client.quic.send_stream_data(stream, said, end_stream=True)
                            case 3:
                                client.http.send_datagram(session, request())
                            case _:
                                client.quic.send_stream_data(stream, said)
                    except (RuntimeError, ValueError):
                        pass  # streams that this client itself has ended
                    if rng.random() < 0.3:
                        client.transmit()
                        await asyncio.sleep(0)
                client.transmit()
                await asyncio.sleep(0.01)
                await close_client(client)
            await still_serves(server.port)

    run(work())
