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
from splatwire.transport import ReceiverOptions, socket_group
from splatwire.transport.address import Address
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
from splatwire.transport.socket_group import (
    QUIC_CLASSES,
    SOCKETS_PER_CLASS,
    TOKEN_PREFIX,
    TURN_DATAGRAMS,
    UDP_CLASSES,
    DatagramClass,
    Instruction,
    SocketGroup,
)
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
def group(request: pytest.FixtureRequest) -> Iterator[SocketGroup]:
    host, classes = getattr(request, "param", ("127.0.0.1", QUIC_CLASSES))
    group = SocketGroup(host, 0, classes)
    yield group
    group.close()


def arrived(group: SocketGroup) -> Counter[int]:
    """Number of datagrams that wait, by index of the socket."""
    counts: Counter[int] = Counter()
    for index, one in enumerate(group.sockets):
        while True:
            try:
                one.recv(2048)
            except BlockingIOError:
                break
            counts[index] += 1
    return counts


def send(group: SocketGroup, data: bytes, source: str = "127.0.0.1", count: int = 1, ports: int = 1) -> None:
    for _ in range(ports):
        family = socket.AF_INET6 if ":" in source else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as sender:
            sender.bind((source, 0))
            for _ in range(count):
                sender.sendto(data, (source if ":" in source else "127.0.0.1", group.port))


@ON_LINUX
@pytest.mark.parametrize("group", [("127.0.0.1", QUIC_CLASSES), ("::", QUIC_CLASSES)], indirect=True)
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (initial(), DatagramClass.NEW),
        (initial(token=b"token of another server"), DatagramClass.NEW),
        (initial(token=TOKEN), DatagramClass.TOKEN),
        (initial(ids=(20, 0), token=TOKEN), DatagramClass.TOKEN),
        (initial(ids=(0, 20), token=TOKEN), DatagramClass.TOKEN),
        (initial(QUIC_2, 0xD0, token=TOKEN), DatagramClass.TOKEN),
        (initial(QUIC_2, 0xD0), DatagramClass.NEW),
        (initial(first=0xE0), DatagramClass.KNOWN),  # Handshake
        (initial(QUIC_2, 0xF0), DatagramClass.KNOWN),
        (initial(b"\xfa\xfa\xfa\xfa", token=TOKEN), DatagramClass.NEW),
        (b"\x41" + bytes(30), DatagramClass.KNOWN),
        (initial(ids=(255, 255))[:300], DatagramClass.NEW),
        (b"\xc0", DatagramClass.NEW),
        (b"", DatagramClass.NEW),
    ],
)
def test_quic_packets_are_classified_by_their_header(group: SocketGroup, data: bytes, expected: DatagramClass) -> None:
    send(group, data, "::1" if group.sockets[0].family == socket.AF_INET6 else "127.0.0.1", 20)
    assert {index // SOCKETS_PER_CLASS for index in arrived(group)} == {expected}


@ON_LINUX
@pytest.mark.parametrize("group", [("127.0.0.1", UDP_CLASSES)], indirect=True)
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (encode(Hello(1, "")), DatagramClass.NEW),
        (encode(Request(1, bytes(16), "")), DatagramClass.TOKEN),
        (encode(Bye(1)), DatagramClass.KNOWN),
        (bytes([encode(Hello(1, ""))[0] ^ 0x10]) + bytes(1199), DatagramClass.NEW),  # another version
        (initial(token=TOKEN), DatagramClass.NEW),
    ],
)
def test_datagrams_are_classified_by_their_kind(group: SocketGroup, data: bytes, expected: DatagramClass) -> None:
    send(group, data, count=20)
    assert {index // SOCKETS_PER_CLASS for index in arrived(group)} == {expected}


@ON_LINUX
def test_datagrams_of_a_connection_wait_in_one_socket_and_keep_their_order(group: SocketGroup) -> None:
    send(group, b"\x41" + bytes(30), count=60)
    assert list(arrived(group).values()) == [60]


@ON_LINUX
def test_a_flood_fills_one_socket_of_each_half_or_half_of_them(group: SocketGroup) -> None:
    half = SOCKETS_PER_CLASS // 2
    send(group, initial(), "127.7.0.1", count=200)
    one_port = arrived(group)
    assert [sum(index // half == part for index in one_port) for part in range(2)] == [1, 1]
    assert min(one_port.values()) > 40
    send(group, initial(), "127.7.0.1", count=4, ports=100)
    one_network = arrived(group)
    assert [sum(index // half == part for index in one_network) for part in range(2)] == [1, half]
    networks = {next(iter(arrived(group))) for n in range(200) if send(group, b"\x41", f"127.7.{n}.1") is None}
    assert len(networks) == SOCKETS_PER_CLASS


@ON_LINUX
def test_a_flood_of_new_clients_loses_no_datagram_of_a_connection(group: SocketGroup) -> None:
    """The sockets for new clients overflow, and nothing reads meanwhile."""
    for n in range(16):
        send(group, initial(), f"127.7.{n}.1", count=500)
    send(group, b"\x41" + bytes(30), count=50)
    counts = arrived(group)
    assert sum(counts[index] for index in range(SOCKETS_PER_CLASS)) < 16 * 500
    assert sum(counts[DatagramClass.KNOWN * SOCKETS_PER_CLASS + index] for index in range(SOCKETS_PER_CLASS)) == 50


def test_another_server_cannot_listen_on_the_same_port(group: SocketGroup) -> None:
    with pytest.raises(InvalidValueError, match=f"cannot listen on UDP port {group.port}"):
        SocketGroup("127.0.0.1", group.port, QUIC_CLASSES)


@pytest.mark.parametrize("classes", [UDP_CLASSES, QUIC_CLASSES])
def test_systems_without_socket_groups_have_one_socket(
    classes: tuple[Instruction, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    group = SocketGroup("127.0.0.1", 0, classes)
    send(group, b"anything", count=3)
    assert arrived(group) == Counter({0: 3})
    group.close()


@ON_LINUX
def test_a_linux_without_programs_for_socket_groups_has_one_socket(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOPROTOOPT, os.strerror(errno.ENOPROTOOPT))

    monkeypatch.setattr(socket_group, "_attach", unsupported)
    group = SocketGroup("127.0.0.1", 0, QUIC_CLASSES)
    send(group, b"anything", count=3, ports=20)
    assert arrived(group) == Counter({0: 60})
    assert "one receive buffer" in caplog.text
    with pytest.raises(InvalidValueError, match=f"cannot listen on UDP port {group.port}"):
        SocketGroup("127.0.0.1", group.port, QUIC_CLASSES)
    group.close()


@ON_LINUX
def test_each_turn_of_the_event_loop_reads_few_datagrams_of_each_socket(group: SocketGroup) -> None:
    async def work() -> None:
        read: list[tuple[socket.socket, int]] = []
        for _ in range(2):
            send(group, initial(), count=5)
            send(group, b"\x41", count=5)
        group.add_readers(asyncio.get_running_loop(), lambda source, most: read.append((source, most)))
        for _ in range(2):
            await asyncio.sleep(0)
        group.remove_readers(asyncio.get_running_loop())
        by_class = {
            datagram_class: {
                most for source, most in read if group.sockets.index(source) // SOCKETS_PER_CLASS == datagram_class
            }
            for datagram_class in DatagramClass
        }
        assert by_class == {
            DatagramClass.NEW: {TURN_DATAGRAMS[DatagramClass.NEW]},
            DatagramClass.TOKEN: set(),
            DatagramClass.KNOWN: {TURN_DATAGRAMS[DatagramClass.KNOWN]},
        }

    asyncio.run(work())


def test_responses_are_limited_per_address_network_and_in_total() -> None:
    budget = ResponseBudget()
    assert sum(budget.take(HERE, 0.0) for _ in range(100)) == MAX_ADDRESS_RESPONSES
    assert budget.take(("192.0.2.1", 4001), 0.0)
    ports = sum(budget.take(("192.0.2.1", port), 0.0) for port in range(5000, 5000 + 2 * MAX_RESPONSES))
    assert ports == MAX_RESPONSES // 2 - MAX_ADDRESS_RESPONSES - 1
    assert sum(budget.take(("203.0.113.9", port), 0.0) for port in range(100)) == MAX_NETWORK_RESPONSES
    assert budget.take(("198.51.100.7", 1), 0.0)
    networks = [(f"2001:db8:{n:x}::1", 1, 0, 0) for n in range(2 * MAX_RESPONSES)]
    assert sum(budget.take(address, 0.0) for address in networks) == MAX_RESPONSES // 2 - 1 - MAX_NETWORK_RESPONSES
    assert not budget.take(("198.51.100.8", 1), 0.0)
    assert len(budget._addresses) <= MAX_RESPONSES
    assert budget.take(("198.51.100.8", 1), WINDOW_S)


def test_ipv4_clients_of_a_socket_for_both_versions_have_budgets_of_their_own() -> None:
    budget = ResponseBudget()
    for port in range(MAX_RESPONSES):
        budget.take(("::ffff:192.0.2.1", port, 0, 0), 0.0)
    assert not budget.may_respond(("::ffff:192.0.2.1", MAX_RESPONSES, 0, 0), 0.0)
    assert budget.may_respond(("::ffff:192.0.2.2", 1, 0, 0), 0.0)


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
