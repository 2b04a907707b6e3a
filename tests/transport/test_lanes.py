"""Datagrams of new and known clients, and of different addresses, wait in different sockets of a server's port."""

import asyncio
import errno
import logging
import os
import random
import socket
import sys
from collections import Counter
from collections.abc import Iterator

import pytest

from splatwire.errors import InvalidValueError
from splatwire.transport import ReceiverOptions
from splatwire.transport import lanes as lane_sockets
from splatwire.transport.address import Address
from splatwire.transport.lanes import (
    LANES_PER_CLASS,
    QUIC_CLASSES,
    TOKEN_PREFIX,
    TURN_DATAGRAMS,
    UDP_CLASSES,
    Instruction,
    LaneClass,
    LaneSockets,
)
from splatwire.transport.protocol import response_budget
from splatwire.transport.protocol.messages import Bye, Hello, Request
from splatwire.transport.protocol.response_budget import (
    MAX_ADDRESS_RESPONSES,
    MAX_NETWORK_RESPONSES,
    MAX_RESPONSES,
    WINDOW_S,
    ResponseBudget,
)
from splatwire.transport.protocol.send_schedule import Protection
from splatwire.transport.protocol.served_stream import make_served_stream
from splatwire.transport.protocol.wire import encode
from splatwire.transport.udp import MIN_DROPPED, UdpServer, receive_udp
from transport.network import datagram_stream

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems have one socket per port")
HERE = ("192.0.2.1", 4000)


def initial(
    version: bytes = b"\0\0\0\1", first: int = 0xC0, ids: tuple[int, int] = (8, 8), token: bytes = b""
) -> bytes:
    """An Initial packet without valid content."""
    head = bytes([first]) + version + bytes([ids[0]]) + bytes(ids[0]) + bytes([ids[1]]) + bytes(ids[1])
    return (head + bytes([len(token)]) + token).ljust(1200, b"\0")


TOKEN = TOKEN_PREFIX + bytes(28)
QUIC_2 = bytes.fromhex("6b3343cf")


@pytest.fixture
def lanes(request: pytest.FixtureRequest) -> Iterator[LaneSockets]:
    host, classes = getattr(request, "param", ("127.0.0.1", QUIC_CLASSES))
    sockets = LaneSockets(host, 0, classes)
    yield sockets
    sockets.close()


def arrived(sockets: LaneSockets) -> Counter[int]:
    """Number of datagrams that wait, by index of the socket."""
    counts: Counter[int] = Counter()
    for index, one in enumerate(sockets.sockets):
        while True:
            try:
                one.recv(2048)
            except BlockingIOError:
                break
            counts[index] += 1
    return counts


def send(sockets: LaneSockets, data: bytes, source: str = "127.0.0.1", count: int = 1, ports: int = 1) -> None:
    for _ in range(ports):
        family = socket.AF_INET6 if ":" in source else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as sender:
            sender.bind((source, 0))
            for _ in range(count):
                sender.sendto(data, (source if ":" in source else "127.0.0.1", sockets.port))


@ON_LINUX
@pytest.mark.parametrize("lanes", [("127.0.0.1", QUIC_CLASSES), ("::", QUIC_CLASSES)], indirect=True)
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (initial(), LaneClass.NEW),
        (initial(token=b"token of another server"), LaneClass.NEW),
        (initial(token=TOKEN), LaneClass.TOKEN),
        (initial(ids=(20, 0), token=TOKEN), LaneClass.TOKEN),
        (initial(ids=(0, 20), token=TOKEN), LaneClass.TOKEN),
        (initial(QUIC_2, 0xD0, token=TOKEN), LaneClass.TOKEN),
        (initial(QUIC_2, 0xD0), LaneClass.NEW),
        (initial(first=0xE0), LaneClass.KNOWN),  # Handshake
        (initial(QUIC_2, 0xF0), LaneClass.KNOWN),
        (initial(b"\xfa\xfa\xfa\xfa", token=TOKEN), LaneClass.NEW),
        (b"\x41" + bytes(30), LaneClass.KNOWN),
        (initial(ids=(255, 255))[:300], LaneClass.NEW),
        (b"\xc0", LaneClass.NEW),
        (b"", LaneClass.NEW),
    ],
)
def test_quic_packets_are_classified_by_their_header(lanes: LaneSockets, data: bytes, expected: LaneClass) -> None:
    send(lanes, data, "::1" if lanes.sockets[0].family == socket.AF_INET6 else "127.0.0.1", 20)
    assert {index // LANES_PER_CLASS for index in arrived(lanes)} == {expected}


@ON_LINUX
@pytest.mark.parametrize("lanes", [("127.0.0.1", UDP_CLASSES)], indirect=True)
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (encode(Hello(1, "")), LaneClass.NEW),
        (encode(Request(1, bytes(16), "")), LaneClass.TOKEN),
        (encode(Bye(1)), LaneClass.KNOWN),
        (bytes([encode(Hello(1, ""))[0] ^ 0x10]) + bytes(1199), LaneClass.NEW),  # another version
        (initial(token=TOKEN), LaneClass.NEW),
    ],
)
def test_datagrams_are_classified_by_their_kind(lanes: LaneSockets, data: bytes, expected: LaneClass) -> None:
    send(lanes, data, count=20)
    assert {index // LANES_PER_CLASS for index in arrived(lanes)} == {expected}


@ON_LINUX
def test_datagrams_of_a_connection_wait_in_one_socket_and_keep_their_order(lanes: LaneSockets) -> None:
    send(lanes, b"\x41" + bytes(30), count=60)
    assert list(arrived(lanes).values()) == [60]


@ON_LINUX
def test_a_flood_fills_one_socket_of_each_half_or_half_of_them(lanes: LaneSockets) -> None:
    half = LANES_PER_CLASS // 2
    send(lanes, initial(), "127.7.0.1", count=200)
    one_port = arrived(lanes)
    assert [sum(index // half == part for index in one_port) for part in range(2)] == [1, 1]
    assert min(one_port.values()) > 40
    send(lanes, initial(), "127.7.0.1", count=4, ports=100)
    one_network = arrived(lanes)
    assert [sum(index // half == part for index in one_network) for part in range(2)] == [1, half]
    networks = {next(iter(arrived(lanes))) for n in range(60) if send(lanes, b"\x41", f"127.7.{n}.1") is None}
    assert len(networks) == LANES_PER_CLASS


@ON_LINUX
def test_a_flood_of_new_clients_loses_no_datagram_of_a_connection(lanes: LaneSockets) -> None:
    """The sockets for new clients overflow, and nothing reads meanwhile."""
    for n in range(16):
        send(lanes, initial(), f"127.7.{n}.1", count=500)
    send(lanes, b"\x41" + bytes(30), count=50)
    counts = arrived(lanes)
    assert sum(counts[index] for index in range(LANES_PER_CLASS)) < 16 * 500
    assert sum(counts[LaneClass.KNOWN * LANES_PER_CLASS + index] for index in range(LANES_PER_CLASS)) == 50


def test_another_server_cannot_listen_on_the_same_port(lanes: LaneSockets) -> None:
    with pytest.raises(InvalidValueError, match=f"cannot listen on UDP port {lanes.port}"):
        LaneSockets("127.0.0.1", lanes.port, QUIC_CLASSES)


@pytest.mark.parametrize("classes", [UDP_CLASSES, QUIC_CLASSES])
def test_systems_without_socket_groups_have_one_socket(
    classes: tuple[Instruction, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    sockets = LaneSockets("127.0.0.1", 0, classes)
    send(sockets, b"anything", count=3)
    assert arrived(sockets) == Counter({0: 3})
    sockets.close()


@ON_LINUX
def test_a_linux_without_programs_for_socket_groups_has_one_socket(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOPROTOOPT, os.strerror(errno.ENOPROTOOPT))

    monkeypatch.setattr(lane_sockets, "_attach", unsupported)
    sockets = LaneSockets("127.0.0.1", 0, QUIC_CLASSES)
    send(sockets, b"anything", count=3, ports=20)
    assert arrived(sockets) == Counter({0: 60})
    assert "one receive buffer" in caplog.text
    with pytest.raises(InvalidValueError, match=f"cannot listen on UDP port {sockets.port}"):
        LaneSockets("127.0.0.1", sockets.port, QUIC_CLASSES)
    sockets.close()


@ON_LINUX
def test_each_turn_of_the_event_loop_reads_few_datagrams_of_each_socket(lanes: LaneSockets) -> None:
    async def work() -> None:
        read: list[tuple[socket.socket, int]] = []
        for _ in range(2):
            send(lanes, initial(), count=5)
            send(lanes, b"\x41", count=5)
        lanes.add_readers(asyncio.get_running_loop(), lambda lane, most: read.append((lane, most)))
        for _ in range(2):
            await asyncio.sleep(0)
        lanes.remove_readers(asyncio.get_running_loop())
        by_class = {
            lane_class: {most for lane, most in read if lanes.sockets.index(lane) // LANES_PER_CLASS == lane_class}
            for lane_class in LaneClass
        }
        assert by_class == {
            LaneClass.NEW: {TURN_DATAGRAMS[LaneClass.NEW]},
            LaneClass.TOKEN: set(),
            LaneClass.KNOWN: {TURN_DATAGRAMS[LaneClass.KNOWN]},
        }

    asyncio.run(work())


def test_responses_are_limited_per_address_network_and_in_total() -> None:
    budget = ResponseBudget()
    assert sum(budget.take(HERE, 0.0) for _ in range(100)) == MAX_ADDRESS_RESPONSES
    assert budget.take(("192.0.2.1", 4001), 0.0)
    ports = sum(budget.take(("192.0.2.1", port), 0.0) for port in range(5000, 5000 + 2 * MAX_RESPONSES))
    assert ports == MAX_RESPONSES // 2 - MAX_ADDRESS_RESPONSES - 1
    assert budget.take(("198.51.100.7", 1), 0.0)
    networks = [(f"2001:db8:{n:x}::1", 1, 0, 0) for n in range(2 * MAX_RESPONSES)]
    assert sum(budget.take(address, 0.0) for address in networks) == MAX_RESPONSES // 2 - 1
    assert not budget.take(("198.51.100.8", 1), 0.0)
    assert len(budget._addresses) <= MAX_RESPONSES
    assert budget.take(("198.51.100.8", 1), WINDOW_S)
    assert MAX_NETWORK_RESPONSES > 1


def test_a_flood_of_hellos_gets_few_responses_and_others_get_theirs(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(response_budget, "WINDOW_S", 1000.0)

    async def work() -> None:
        stream = datagram_stream(num_anchors=500)
        server = UdpServer({"scene": make_served_stream(stream, Protection())}, "127.0.0.1", 0)
        received = Counter[str]()
        original = server.core.receive

        def receive(address: tuple[str, int], data: bytes, now: float) -> bytes | None:
            received[address[0]] += 1
            return original(address, data, now)

        monkeypatch.setattr(server.core, "receive", receive)
        rng = random.Random(1)

        class Flood(socket.socket):
            def recvfrom(self, *_: int) -> tuple[bytes, tuple[str, int]]:
                return encode(Hello(rng.getrandbits(64), "")), ("127.0.0.9", rng.randrange(1024, 60_000))

        with caplog.at_level(logging.WARNING), Flood(socket.AF_INET, socket.SOCK_DGRAM) as flood:
            server._readable(flood, 5 * MAX_RESPONSES)
            assert (received["127.0.0.9"], server.num_dropped) == (MAX_RESPONSES // 2, 9 * MAX_RESPONSES // 2)
            receiver = await receive_udp(Address("127.0.0.1", server.port), ReceiverOptions())
        assert receiver.stream() == stream
        (line,) = [record.getMessage() for record in caplog.records]
        assert line == f"connection attempts dropped count={MIN_DROPPED}"
        server.close()

    asyncio.run(asyncio.wait_for(work(), 60))
