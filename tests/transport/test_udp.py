"""Real sockets, on loopback only; every wait is bounded."""

import asyncio
import errno
import random
import socket
import sys
import threading
from collections.abc import Coroutine
from contextlib import ExitStack
from typing import Any

import pytest

from splatwire.bitstream import SceneStream
from splatwire.errors import InvalidValueError
from splatwire.transport import (
    Event,
    Finished,
    PacketArrived,
    Protection,
    Receiver,
    ReceiverOptions,
    ServerLimits,
    local_addresses,
    make_served_stream,
    udp,
)
from splatwire.transport.address import DEFAULT_PORT, Address, parse_url
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer
from splatwire.transport.protocol.messages import Hello
from splatwire.transport.protocol.wire import encode
from splatwire.transport.socket_group import bound_socket
from splatwire.transport.udp import (
    MAX_PENDING_RESPONSES,
    UdpServer,
    connected_socket,
    receive_udp,
    resolve,
)
from transport.network import FailingCallbackError, at_most, bernoulli, bursts, datagram_stream, fail_on_event
from transport.relay import Relay

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
STREAM = datagram_stream()
OTHER = datagram_stream(num_anchors=500, seed=9, side_bytes=3000)


def run(work: Coroutine[Any, Any, Any]) -> Any:
    return asyncio.run(asyncio.wait_for(work, 240))


def served(*streams: SceneStream, limits: ServerLimits | None = None) -> UdpServer:
    programs = {f"scene{n}": make_served_stream(stream, Protection()) for n, stream in enumerate(streams)}
    return UdpServer(programs, "127.0.0.1", 0, limits=limits)


async def fetch(port: int, options: ReceiverOptions | None = None, on_event: Any = None) -> Receiver:
    return await receive_udp(Address("127.0.0.1", port), options or ReceiverOptions(), on_event)


def test_stream_is_transferred_over_loopback():
    async def work() -> None:
        server, events = served(STREAM), []
        try:
            receiver = await fetch(server.port, on_event=events.append)
        finally:
            server.close()
        assert receiver.finished.reason == "complete"
        assert receiver.stream() == STREAM
        assert sum(isinstance(event, PacketArrived) for event in events) == len(STREAM.packets)

    run(work())


@pytest.mark.parametrize("kind", ["random", "burst"])
def test_stream_passes_a_lossy_relay(kind):
    async def work() -> None:
        rng = random.Random(1)
        lost = bernoulli(0.2, rng) if kind == "random" else at_most(bursts(0.2, 20, rng), 0.3)
        server = served(STREAM)
        relay = Relay(server.port, lost, bernoulli(0.2, rng), delay_s=0.005)
        try:
            receiver = await fetch(relay.port)
        finally:
            relay.close()
            server.close()
        assert relay.num_lost > 20
        assert receiver.stream() == STREAM

    run(work())


def test_many_clients_share_one_stream():
    async def work() -> None:
        server = served(STREAM, OTHER, limits=ServerLimits(per_network=24, fixed_rate=4e5))
        try:
            names = ["scene0", "scene1", ""] * 8
            tasks = [fetch(server.port, ReceiverOptions(name=name)) for name in names]
            receivers = await asyncio.gather(*tasks)
        finally:
            server.close()
        for name, receiver in zip(names, receivers, strict=True):
            assert receiver.stream() == (OTHER if name == "scene1" else STREAM)
        assert server.core.num_served == 24
        assert server.core.num_transfers == 0

    run(work())


def test_deadline_ends_the_transfer():
    async def work() -> None:
        server = served(STREAM, limits=ServerLimits(fixed_rate=1.5e5))
        try:
            receiver = await fetch(server.port, ReceiverOptions(deadline_s=1.6))
        finally:
            server.close()
        assert receiver.finished.reason == "deadline"
        assert receiver.collector is None or receiver.collector.num_packets < len(STREAM.packets)

    run(work())


def test_unreachable_server_is_reported_at_once():
    async def work() -> None:
        server = served(OTHER)
        port = server.port
        server.close()
        receiver = await fetch(port)
        assert not receiver.finished.ok
        assert receiver.stream() is None

    run(work())


def test_responses_that_the_socket_does_not_accept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow uplink accepts fewer responses than there are requests in a flood."""

    class Blocked(socket.socket):
        def __init__(self) -> None:
            super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
            self.hellos = [encode(Hello(nonce, "")) for nonce in range(2 * MAX_PENDING_RESPONSES)]

        def recvfrom(self, *_: int) -> tuple[bytes, tuple[str, int]]:
            if not self.hellos:
                raise BlockingIOError
            return self.hellos.pop(), ("127.0.0.1", len(self.hellos))

        def sendto(self, *_: object) -> int:
            raise BlockingIOError

    async def work() -> None:
        server, blocked = served(OTHER), Blocked()
        monkeypatch.setattr(server._responses, "take", lambda address, now: True)
        real = server._socket
        server._socket = blocked
        server._blocked = True
        while blocked.hellos:
            server._readable(blocked, 64)
        assert len(server._backlog) == MAX_PENDING_RESPONSES
        server._socket = real
        blocked.close()
        server.close()

    run(work())


def test_flood_of_requests_does_not_stop_transfers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each time the socket is read, a request waits, so that responses are never all sent before the next turn."""

    class Flooded(socket.socket):
        def __init__(self) -> None:
            super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
            self.sent = list[bytes]()

        def recvfrom(self, *_: int) -> tuple[bytes, tuple[str, int]]:
            return encode(Hello(1, "")), ("127.0.0.1", 9)

        def sendto(self, data: bytes, *_: object) -> int:  # type: ignore[override]
            self.sent.append(data)
            return len(data)

    async def work() -> None:
        server, flooded = served(OTHER), Flooded()
        real = server._socket
        server._socket = flooded
        monkeypatch.setattr(server.core, "poll", lambda now, count: [(("127.0.0.1", 8), b"packet")])
        for _ in range(3):
            server._readable(flooded, 64)
        assert flooded.sent.count(b"packet") == 3
        server._socket = real
        flooded.close()
        server.close()

    run(work())


def test_interrupted_transfer_keeps_received_packets():
    async def work() -> None:
        server, stop = served(STREAM, limits=ServerLimits(fixed_rate=1.5e5)), asyncio.get_running_loop().create_future()

        def note(event: Event) -> None:
            if isinstance(event, PacketArrived) and not stop.done():
                stop.set_result(None)

        try:
            receiver = await receive_udp(Address("127.0.0.1", server.port), ReceiverOptions(), note, stop=stop)
        finally:
            server.close()
        assert receiver.finished.reason == "stopped"
        assert 0 < len(receiver.stream().packets) < len(STREAM.packets)
        assert (
            receiver.describe_missing() == f"{len(receiver.stream().packets)} of {len(STREAM.packets)} packets arrived"
        )

    run(work())


@pytest.mark.slow
def test_transfer_continues_after_this_machine_gets_another_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """A socket keeps the address of the machine: after a change, it can send nothing. For a time there is no route."""
    opened, refused, moved = list[socket.socket](), 3, False

    class Socket(socket.socket):
        def send(self, *given: Any) -> int:
            if moved and self is opened[0]:
                raise OSError(errno.EINVAL, "Invalid argument")
            return super().send(*given)

        def recv(self, *given: Any) -> bytes:
            if moved and self is opened[0]:
                raise BlockingIOError
            return super().recv(*given)

    def open_socket(family: socket.AddressFamily, target: Any) -> socket.socket:
        nonlocal refused
        if opened and refused:
            refused -= 1
            raise OSError(errno.ENETUNREACH, "Network is unreachable")
        opened.append(Socket(fileno=connected_socket(family, target).detach()))
        opened[-1].setblocking(False)
        return opened[-1]

    monkeypatch.setattr(udp, "connected_socket", open_socket)

    async def work() -> None:
        server, count = served(STREAM, limits=ServerLimits(fixed_rate=4e5)), 0

        def note(event: Event) -> None:
            nonlocal count, moved
            count += isinstance(event, PacketArrived)
            moved = moved or count == len(STREAM.packets) // 4

        try:
            receiver = await fetch(server.port, on_event=note)
        finally:
            server.close()
        assert receiver.finished.reason == "complete"
        assert receiver.stream() == STREAM
        assert len(opened) > 1
        assert refused == 0
        assert all(each.fileno() == -1 for each in opened)

    run(work())


def test_a_host_that_a_router_reports_as_unreachable_leaves_the_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[socket.socket]()

    class Socket(socket.socket):
        failures = 3

        def send(self, *given: Any) -> int:
            if self.failures:
                self.failures -= 1
                raise OSError(errno.EHOSTUNREACH, "No route to host")
            return super().send(*given)

    def open_socket(family: socket.AddressFamily, target: Any) -> socket.socket:
        opened.append(Socket(fileno=connected_socket(family, target).detach()))
        opened[-1].setblocking(False)
        return opened[-1]

    monkeypatch.setattr(udp, "connected_socket", open_socket)

    async def work() -> None:
        server = served(STREAM)
        try:
            receiver = await fetch(server.port)
        finally:
            server.close()
        assert receiver.stream() == STREAM
        assert len(opened) == 1

    run(work())


def test_a_socket_that_cannot_be_connected_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[socket.socket]()

    class Socket(socket.socket):
        def connect(self, target: Any) -> None:
            opened.append(self)
            raise OSError(errno.EHOSTUNREACH, "No route to host")

    monkeypatch.setattr(udp.socket, "socket", Socket)
    with pytest.raises(OSError, match="No route to host") as caught:
        connected_socket(socket.AF_INET, ("127.0.0.1", 1))
    assert caught.value.errno in udp.NO_ROUTE_ERRORS
    assert [each.fileno() for each in opened] == [-1]


def test_a_port_in_use_is_named():
    async def work() -> None:
        server = served(OTHER)
        try:
            with pytest.raises(InvalidValueError, match=f"UDP port {server.port} of 127.0.0.1: .*in use"):
                UdpServer({}, "127.0.0.1", server.port)
            with pytest.raises(InvalidValueError, match=r"UDP port 1 of no-such-host\.invalid"):
                UdpServer({}, "no-such-host.invalid", 1)
        finally:
            server.close()
        async with PageServer(PageContent({})) as page:
            with pytest.raises(InvalidValueError, match=f"TCP port {page.port} of 127.0.0.1: .*in use"):
                await PageServer(PageContent({}), page.port).__aenter__()

    run(work())


def test_callback_error_is_raised_in_the_caller():
    async def work() -> None:
        server = served(OTHER)
        try:
            with pytest.raises(FailingCallbackError):
                await fetch(server.port, on_event=fail_on_event)
        finally:
            server.close()

    run(work())


def test_udp_addresses_are_parsed():
    assert parse_url("udp://example.org:1234/scene") == Address("example.org", 1234, "scene")
    assert parse_url("udp://h/my%20K%C3%BCche") == parse_url("udp://h/my Küche") == Address("h", 4840, "my Küche")
    assert parse_url("udp://h/100% real").name == "100% real"
    assert parse_url("udp://h/a%2Fb").name == "a/b"
    assert parse_url("udp://[::1]") == Address("::1", DEFAULT_PORT)
    for wrong in (
        "http://x",
        "example.org",
        "udp://",
        "udp://h:99999",
        "udp://h:x",
        "udp://a@b",
        "udp://h?q",
        "udp://[::1",
        "udp://h:0",
        "udp://h/\udcff",
        "quic://h\udcff/room",
    ):
        with pytest.raises(InvalidValueError, match="is not an address"):
            parse_url(wrong)
    with pytest.raises(InvalidValueError, match="is not known"):
        run(receive_udp(Address("no-such-host.invalid", 1), ReceiverOptions()))


@pytest.mark.parametrize("host", ["a" * 70 + ".com", "a..b"])
def test_names_that_no_host_can_have_are_refused(host: str) -> None:
    with pytest.raises(InvalidValueError, match="is not known: it is no host name"):
        asyncio.run(resolve(Address(host, 1)))
    with pytest.raises(InvalidValueError, match=r"cannot listen on UDP port 0 of a.*no host name"):
        bound_socket(host, 0)


def test_parts_of_relay_addresses_are_split_before_they_are_decoded() -> None:
    for text, namespace, name, url in (
        ("moq://relay/a%3Fb/scene", "a%3Fb", "scene", "moq://relay:443/a%3Fb/scene"),
        ("moq://relay/a%2Fb", "", "a/b", "moq://relay:443/a%2Fb"),
        ("moq://relay/x/a%2fb/my room%0A", "x/a%2Fb", "my room\n", "moq://relay:443/x/a%2Fb/my%20room%0A"),
        ("moq://[::1]:4/Küche@1/100% a", "K%C3%BCche@1", "100% a", "moq://[::1]:4/K%C3%BCche@1/100%25%20a"),
    ):
        address = parse_url(text)
        assert (address.namespace, address.name, address.url) == (namespace, name, url)
        assert parse_url(url) == address
    assert parse_url("udp://h/a%2Fb/c") == Address("h", 4840, "a/b/c")


@pytest.mark.parametrize("name", ["a\nb", "a\u200db", "\udcff", "é" * 33])
def test_names_that_servers_ignore_are_refused(name: str) -> None:
    with pytest.raises(InvalidValueError, match="at most 64 bytes, all printable"):
        ReceiverOptions(name)


def test_all_addresses_of_a_name_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    six, four = ("::1", 7, 0, 0), ("127.0.0.1", 7)
    found = [(socket.AF_INET6, socket.SOCK_DGRAM, 17, "", six)] * 2 + [
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", four)
    ]
    monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: found)
    assert asyncio.run(resolve(Address("localhost", 7))) == [(socket.AF_INET6, six), (socket.AF_INET, four)]


@pytest.mark.parametrize("first", ["refuses", "has no route", "is silent"])
def test_a_server_is_found_at_any_of_its_addresses(monkeypatch: pytest.MonkeyPatch, first: str) -> None:
    """`localhost` is ::1 and 127.0.0.1 on many systems, and a server listens at one of them."""
    monkeypatch.setattr(udp, "ADDRESS_TIMEOUT_S", 0.5)

    def connected(family: socket.AddressFamily, target: Any) -> socket.socket:
        if first == "has no route" and target[0] == "127.0.0.2":
            raise OSError(errno.ENETUNREACH, "Network is unreachable")
        return connected_socket(family, target)

    async def work() -> None:
        server, silent = served(STREAM), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        targets = [("127.0.0.2", server.port), ("127.0.0.1", server.port)]

        async def resolved(_: Address) -> list[tuple[socket.AddressFamily, Any]]:
            return [(socket.AF_INET, target) for target in targets]

        monkeypatch.setattr(udp, "resolve", resolved)
        monkeypatch.setattr(udp, "connected_socket", connected)
        try:
            if first == "is silent":
                silent.bind(targets[0])
            assert (await fetch(server.port)).stream() == STREAM
        finally:
            silent.close()
            server.close()
        if first == "refuses":
            targets[1] = ("127.0.0.3", server.port)
            assert (await fetch(server.port)).finished.reason == "nothing listens there"

    run(work())


@pytest.mark.parametrize("is_late", [False, True])
def test_a_stop_after_the_end_of_a_transfer_opens_no_socket(monkeypatch: pytest.MonkeyPatch, is_late: bool) -> None:
    """The end may be a deadline without an answer of the server, at which the next address would be due."""
    monkeypatch.setattr(udp, "ADDRESS_TIMEOUT_S", 0.0)
    opened = list[socket.socket]()

    def connected(family: socket.AddressFamily, target: Any) -> socket.socket:
        opened.append(connected_socket(family, target))
        return opened[-1]

    async def work() -> None:
        with ExitStack() as silent:
            targets = []
            for host in ("127.0.0.2", "127.0.0.1"):
                one = silent.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                one.bind((host, 0))
                targets.append((socket.AF_INET, one.getsockname()))

            async def resolved(_: Address) -> list[tuple[socket.AddressFamily, Any]]:
                return targets

            monkeypatch.setattr(udp, "resolve", resolved)
            monkeypatch.setattr(udp, "connected_socket", connected)
            errors = list[Any]()
            loop = asyncio.get_running_loop()
            loop.set_exception_handler(lambda _, context: errors.append(context))
            stop = loop.create_future()

            def on_event(event: object) -> None:
                if isinstance(event, Finished) and not is_late:
                    loop.call_soon(stop.set_result, None)

            receiver = await receive_udp(Address("name", 1), ReceiverOptions(deadline_s=0.2), on_event, stop=stop)
            assert receiver.finished.reason == "deadline"
            if is_late:
                stop.set_result(None)
            await asyncio.sleep(0.05)
            assert [one.fileno() for one in opened if one.fileno() >= 0] == []
            assert errors == []

    run(work())


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell local addresses")
@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_responses_come_from_the_address_that_a_client_has_sent_to(host: str) -> None:
    """Clients ignore other addresses. A machine may have several, such as a floating one."""

    async def work() -> None:
        try:
            server = UdpServer({"scene": make_served_stream(OTHER, Protection())}, host, 0)
        except InvalidValueError:
            pytest.skip("this machine has no IPv6")
        try:
            for target in ("127.0.0.1", "127.0.0.2", "127.9.9.9", *(["::1"] if host == "::" else [])):
                receiver = await receive_udp(Address(target, server.port), ReceiverOptions())
                assert receiver.stream() == OTHER, target
        finally:
            server.close()

    run(work())


def test_local_addresses_of_few_clients_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """A flood from forged addresses fills no memory."""
    monkeypatch.setattr(local_addresses, "_MAX_CLIENTS", 8)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("0.0.0.0", 0))
        found = local_addresses.local_addresses([server])
        if found is None:
            pytest.skip("the system does not tell local addresses")
        for _ in range(50):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
                client.settimeout(60)
                client.connect(("127.0.0.3", server.getsockname()[1]))
                client.send(b"x")
                data, address = found.receive(server, 100)
                found.send(server, data, address)
                assert client.recv(100) == b"x"
                assert len(found._controls) <= 8


@pytest.mark.parametrize("scheme", ["udp", "quic"])
@pytest.mark.parametrize("reason", ["deadline", "stopped"])
def test_a_transfer_ends_while_the_host_name_is_resolved(
    monkeypatch: pytest.MonkeyPatch, scheme: str, reason: str
) -> None:
    """Without an answer, resolvers take up to half a minute."""
    ended, answered = threading.Event(), threading.Event()

    def blocked(*given: Any, **named: Any) -> Any:
        ended.wait(60)
        answered.set()
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", blocked)
    receive: Any = receive_udp
    if scheme == "quic":
        pytest.importorskip("aioquic", reason="the package aioquic is not installed")
        from splatwire.transport.quic.client import receive_quic as receive

    async def work() -> None:
        loop = asyncio.get_running_loop()
        stop = loop.create_future()
        if reason == "stopped":
            loop.call_later(0.1, stop.cancel)
        options = ReceiverOptions(deadline_s=0.1 if reason == "deadline" else None)
        receiver = await receive(Address("name", 1, scheme=scheme), options, stop=stop)
        assert receiver.finished.reason == reason

    try:
        asyncio.run(work())  # also waits for threads of the loop's executor
        assert not answered.is_set()
    finally:
        ended.set()


def test_a_missing_resource_is_not_taken_for_an_unknown_host(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*given: Any, **named: Any) -> Any:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("socket.getaddrinfo", exhausted)
    with pytest.raises(OSError, match="Too many open files") as caught:
        asyncio.run(resolve(Address("127.0.0.1", 1)))
    assert caught.value.errno == errno.EMFILE


@pytest.mark.parametrize("port", [-1, 70_000, 10**9])
def test_ports_out_of_range_are_refused(port: int) -> None:
    """Resolvers take port 70000 for 4464."""

    async def open_page() -> None:
        async with PageServer(PageContent({}), port):
            pass

    with pytest.raises(InvalidValueError, match="a port is a number from 0 to 65535, "):
        bound_socket("127.0.0.1", port)
    with pytest.raises(InvalidValueError, match="a port is a number from 0 to 65535, "):
        run(open_page())
