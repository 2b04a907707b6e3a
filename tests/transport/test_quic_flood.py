"""Tens of thousands of hostile datagrams into a server, both ends of a transfer, and sessions."""

import asyncio
import gc
import random
import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest

from splatwire.transport import Receiver, ReceiverOptions, Server, ServerLimits
from splatwire.transport.address import Address
from splatwire.transport.protocol.wire import REQUEST, VERSION
from transport.network import SECRET

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.quic import client as quic_client
from splatwire.transport.quic import input_budget
from splatwire.transport.quic.client import receive_quic
from splatwire.transport.quic.common import QuicLimits, length_prefixed
from transport.test_hostile import PROGRAM, handshake, hostile
from transport.test_quic import PINNED, STREAM, run, serving
from transport.test_quic_hostile import ALPN, close_client, connected, still_serves, until

pytestmark = pytest.mark.slow

HOSTILE = 40_000
FRAMES = 4_000
TRACED = 4000
"""Number of last datagrams during which memory must not grow."""
MAX_GROWN = 1_000_000
"""Memory limit in bytes: all allowed connections take less, and the traced part of the flood has 2.5 million."""
VERSIONS = (0, 1, 0x6B3343CF, 0xFF00001D, 0xFFFFFFFF)


def hostile_udp(rng: random.Random, said: list[bytes]) -> bytes:
    """A hostile UDP datagram, derived from datagrams of a real session."""
    data = bytearray(rng.choice(said))
    match rng.randrange(8):
        case 0:
            return rng.randbytes(rng.randrange(1400))
        case 1:  # another kind of packet
            data[0] = rng.choice((0xC0, 0x40)) | rng.randrange(64)
        case 2 | 3:  # bits, cuts
            for _ in range(rng.randrange(1, 5)):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            del data[rng.randrange(1, len(data) + 1) if rng.random() < 0.3 else len(data) :]
        case 4:  # foreign connections
            data[6:14] = rng.randbytes(8)
        case 5:  # impossible counts: sizes of ids, of a token, of the packet
            data[min(rng.choice((5, 14, 15, 23, 24, 32)), len(data) - 1)] = 0xFF
        case 6:  # other versions
            data[1:5] = rng.choice(VERSIONS).to_bytes(4, "big")
    return bytes(data)  # or repeated datagrams


class Flood:
    """Sends hostile datagrams and measures memory during the last of them."""

    def __init__(self, total: int, seed: int, said: list[bytes]) -> None:
        self.left, self.said, self.grown, self._rng = total, said, 0, random.Random(seed)

    def pour(self, count: int, *into: Callable[[bytes, random.Random], None]) -> None:
        for _ in range(min(count, self.left)):
            if self.left == TRACED:
                tracemalloc.start()
            into[self.left % len(into)](hostile_udp(self._rng, self.said), self._rng)
            self.left -= 1
            if self.left == 0:
                gc.collect()  # ended connections have reference cycles
                self.grown = tracemalloc.get_traced_memory()[0]
                tracemalloc.stop()


@pytest.fixture(autouse=True)
def tracing_stopped():
    yield
    tracemalloc.stop()


def test_hostile_udp_datagrams_do_not_stop_the_server():
    """Datagrams of a real session, from many addresses and from its own."""

    async def work() -> None:
        said, failures = [], []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: failures.append(context))
        async with serving(quic=QuicLimits(connections=8)) as server:
            address, here = Address("127.0.0.1", server.port, scheme="quic"), []
            tap = lambda source, target, data: (said.append(data), here.append(source))  # noqa: E731
            await receive_quic(address, ReceiverOptions(name="other"), PINNED, None, tap)
            flood = Flood(HOSTILE, 2, said)

            def take(data: bytes, rng: random.Random) -> None:
                source = here[0] if rng.random() < 0.5 else ("127.0.0.1", rng.randrange(1024, 65_536))
                server._endpoint.datagram_received(data, source)

            while flood.left:
                flood.pour(500, take)
                await asyncio.sleep(0)
            assert len(server.connections) <= 2 * 8 + 16
            assert flood.grown < MAX_GROWN
            assert failures == []
            assert server.core.num_transfers == 0
        async with serving() as server:
            await still_serves(server.port)

    run(work())


def test_a_transfer_completes_while_both_ends_are_flooded(monkeypatch):
    """An on-path attacker with either address changes and repeats datagrams.

    The handshake is not attacked, because an on-path attacker can end any QUIC connection in it (RFC 9000, 21.1).
    """
    clients, said = [], []

    class Seen(quic_client._Client):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            clients.append(self)

    monkeypatch.setattr(quic_client, "_Client", Seen)

    async def work() -> None:
        failures, busy = [], False
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: failures.append(context))
        async with serving(ServerLimits(silence_s=30.0)) as server:  # the flood is no silence, also on a slow machine
            address, flood = Address("127.0.0.1", server.port, scheme="quic"), Flood(HOSTILE, 3, said)

            def tap(source: tuple, target: tuple, data: bytes) -> None:
                nonlocal busy
                if busy:
                    return
                said.append(data)
                if source[1] == server.port and clients[0]._receiver.welcome:  # it arrives, and QUIC is idle
                    busy = True
                    into_client = lambda data, rng: clients[0].datagram_received(data, source)  # noqa: E731
                    into_server = lambda data, rng: server._endpoint.datagram_received(data, target)  # noqa: E731
                    flood.pour(400, into_client, into_server)
                    busy = False

            receiver = await receive_quic(address, ReceiverOptions("scene", silence_s=30.0), PINNED, None, tap)
            assert receiver.finished.reason == "complete"
            assert receiver.stream() == STREAM
            assert flood.left == 0
            assert flood.grown < MAX_GROWN
            assert failures == []
            await still_serves(server.port)

    run(work())


@pytest.mark.parametrize("alpn", [ALPN, "h3"])
def test_hostile_frames_do_not_change_a_session(alpn, monkeypatch):
    """A client with valid QUIC and hostile frames, half of them on the reliable stream."""
    for limit in ("MAX_SHARE", "MAX_NETWORK_SHARE"):  # otherwise the server drops most of so many datagrams
        monkeypatch.setattr(input_budget, limit, 1.0)
    rng = random.Random(4)
    core = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes)
    receiver = Receiver(rng.getrandbits(64), 0.0)
    seen = handshake(core, receiver)
    seen += [data for _, data in core.poll(1.0)]

    def frame() -> bytes:
        while True:
            data = hostile(rng, seen, rng.choice([receiver.welcome.session, rng.getrandbits(32)]), 7)[:1180]
            if data and data[0] != (VERSION << 4 | REQUEST):  # a client may request a stream
                return data

    async def work() -> None:
        async with serving() as server:
            heard, take = [], server.on_message
            server.on_message = lambda session, data: (heard.append(len(data)), take(session, data))
            client = await connected(server.port, alpn)
            session = client.connect_to() if alpn == "h3" else 0
            stream = client.http.create_webtransport_stream(session) if alpn == "h3" else 0
            said = client.http.send_datagram if alpn == "h3" else lambda _, data: client.quic.send_datagram_frame(data)
            client.quic.send_stream_data(stream, length_prefixed(b"\0"))
            for _ in range(FRAMES // 20):
                for _ in range(10):
                    said(session, frame())
                    client.quic.send_stream_data(stream, length_prefixed(frame()))
                client.transmit()
                for _ in range(25):  # the loop reads one datagram at a time; more would be lost
                    await asyncio.sleep(0)
            await until(lambda: len(heard) > 0.75 * FRAMES)
            assert client.ended is None
            assert server.core.num_transfers == 0
            assert server.core.num_rejected > FRAMES // 2
            await still_serves(server.port)
            await close_client(client)

    run(work())
