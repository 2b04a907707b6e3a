"""The QUIC shell on loopback; every wait is bounded."""

import asyncio
import errno
import logging
import random
import socket
import sys
from collections.abc import AsyncIterator, Coroutine
from contextlib import ExitStack, asynccontextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import Packetization
from splatwire.errors import InvalidValueError
from splatwire.lod import Viewpoint, encode_levels
from splatwire.transport import (
    PacketArrived,
    Protection,
    Receiver,
    ReceiverOptions,
    ServedStream,
    ServerLimits,
    SideInfoArrived,
    Welcomed,
    make_served_stream,
)
from splatwire.transport.address import Address, parse_url
from splatwire.transport.protocol import receiver as receiver_module
from splatwire.transport.protocol.events import Interrupted, NotBegun, Resumed
from splatwire.types import SplatScene
from transport.network import FailingCallbackError, at_most, bernoulli, bursts, datagram_stream, fail_on_event
from transport.relay import Relay

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.quic.congestion.base import create_congestion_control
from aioquic.quic.connection import QuicConnection
from aioquic.quic.events import ConnectionTerminated

from splatwire.transport.protocol.transfer import ServerTransfer
from splatwire.transport.protocol.wire import DATA, WELCOME, decode, message_kind
from splatwire.transport.quic import client
from splatwire.transport.quic.certificate import from_pem, self_signed
from splatwire.transport.quic.client import Trust, receive_quic
from splatwire.transport.quic.common import (
    ALPN,
    FULL,
    MAX_UDP_BYTES,
    MAX_UNACKNOWLEDGED,
    MIN_COUNTED_BYTES,
    RATE_CONTROL,
    WINDOW_BYTES,
    QuicLimits,
    configuration,
)
from splatwire.transport.quic.handlers import ConnectedClient
from splatwire.transport.quic.server import QuicServer
from splatwire.transport.udp import UdpServer, connected_socket, receive_udp

pytestmark = pytest.mark.slow

STREAM = datagram_stream(num_anchors=5000, side_bytes=40_000)
OTHER = datagram_stream(num_anchors=500, seed=9, side_bytes=3000)
PREVIEW = bytes(range(256)) * 4
PROGRAMS = {
    "scene": make_served_stream(STREAM, preview=PREVIEW),
    "other": make_served_stream(OTHER, Protection(bundled_share=0.4)),
}
IDENTITY = self_signed()
PINNED = Trust(fingerprint=IDENTITY.fingerprint)


def run(work: Coroutine[Any, Any, Any]) -> Any:
    return asyncio.run(asyncio.wait_for(work, 60))


@asynccontextmanager
async def serving(limits: ServerLimits | None = None, quic: QuicLimits | None = None) -> AsyncIterator[QuicServer]:
    server = QuicServer(PROGRAMS, "127.0.0.1", 0, identity=IDENTITY, limits=limits, quic_limits=quic)
    await server.start()
    try:
        yield server
    finally:
        server.close()


async def fetch(
    port: int, options: ReceiverOptions | None = None, trust: Trust = PINNED, on_event: Any = None
) -> Receiver:
    address = Address("127.0.0.1", port, scheme="quic")
    return await receive_quic(address, options or ReceiverOptions(), trust, on_event)


def test_a_port_of_the_other_transport_is_named():
    async def work() -> None:
        udp = UdpServer(PROGRAMS, "127.0.0.1", 0)
        reason = (await fetch(udp.port)).finished.reason
        assert reason == "this port serves udp://, not quic://: use a udp:// address"
        udp.close()
        async with serving() as server:
            reason = (await receive_udp(Address("127.0.0.1", server.port), ReceiverOptions())).finished.reason
            assert reason == "this port serves quic://, not udp://: use a quic:// address"

    run(work())


@pytest.mark.parametrize("first", ["refuses", "has no route", "is silent"])
def test_a_server_is_found_at_any_of_its_addresses(monkeypatch, first):
    def connected(family, target):
        if first == "has no route" and target[0] == "127.0.0.2":
            raise OSError(errno.ENETUNREACH, "Network is unreachable")
        return connected_socket(family, target)

    async def work() -> None:
        async with serving() as server:
            targets = [("127.0.0.2", server.port), ("127.0.0.1", server.port)]

            async def resolved(_):
                return [(socket.AF_INET, target) for target in targets]

            monkeypatch.setattr("splatwire.transport.udp.resolve", resolved)
            monkeypatch.setattr(client, "connected_socket", connected)
            monkeypatch.setattr(client, "ADDRESS_TIMEOUT_S", 2.0)
            accepted = []
            accept = server.accept
            monkeypatch.setattr(server, "accept", lambda connection: (accepted.append(connection), accept(connection)))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
                if first == "is silent":
                    silent.bind(targets[0])
                assert (await fetch(server.port)).finished.reason == "complete"
            assert len(accepted) == 1
            if first == "refuses":
                targets[1] = ("127.0.0.3", server.port)
                assert (await fetch(server.port)).finished.reason == "nothing listens there"

    run(work())


def test_silent_addresses_follow_each_other_without_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "ADDRESS_TIMEOUT_S", 2.0)
    for pause in ("MIN_PAUSE_S", "MAX_PAUSE_S"):
        monkeypatch.setattr(client, pause, 1000.0)

    async def work() -> None:
        async with serving() as server:
            targets = [(f"127.0.0.{number}", server.port) for number in (2, 3, 1)]

            async def resolved(_: Address) -> list[tuple[socket.AddressFamily, Any]]:
                return [(socket.AF_INET, target) for target in targets]

            monkeypatch.setattr("splatwire.transport.udp.resolve", resolved)
            with ExitStack() as silent:
                for target in targets[:2]:
                    silent.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)).bind(target)
                assert (await asyncio.wait_for(fetch(server.port), 60)).finished.reason == "complete"

    run(work())


def test_an_ended_connection_leaves_the_receiver_to_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    async def work() -> None:
        receiver = Receiver(1, 0.0, reliable=True)
        quic = QuicConnection(configuration=configuration(is_client=True, alpn=[ALPN], idle_s=1.0))
        ended = client._Client(quic, receiver, Trust(), None, None, ("127.0.0.1", 1))
        ended._finish()
        polled = list[float]()
        monkeypatch.setattr(receiver, "poll", polled.append)
        ended.quic_event_received(ConnectionTerminated(0, None, ""))
        assert ended._alarm is None
        ended._tick()
        assert ended._alarm is None
        assert polled == []
        assert receiver.finished is None

    run(work())


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell local addresses")
def test_responses_come_from_the_address_that_a_client_has_sent_to():
    async def work() -> None:
        server = QuicServer(PROGRAMS, "0.0.0.0", 0, identity=IDENTITY)
        await server.start()
        try:
            for target in ("127.0.0.1", "127.0.0.2"):
                address = Address(target, server.port, scheme="quic")
                assert (await receive_quic(address, ReceiverOptions(), PINNED)).finished.reason == "complete"
        finally:
            server.close()

    run(work())


@pytest.mark.parametrize("focal", [200.0, 1e5])
def test_view_of_a_scene_with_levels_gets_all_its_tiles(focal, caplog):
    levels = encode_levels(
        SplatScene(some_splats(3000)), Packetization(block_size=60, lanes=1, grouping="hashed", packet_bytes=500)
    )
    program = make_served_stream(levels)
    matrix = np.eye(4)
    matrix[2, 3] = 50.0

    async def work() -> Receiver:
        server = QuicServer({"scene": program}, "127.0.0.1", 0, identity=IDENTITY)
        await server.start()
        try:
            return await fetch(server.port, ReceiverOptions(viewpoint=Viewpoint(matrix, focal, 320, 240)))
        finally:
            server.close()

    receiver = run(work())
    assert receiver.finished.ok
    opening = {packet.id for packet in levels.packets if packet.data in program.packets[: program.opening_packets]}
    assert opening <= {packet.id for packet in receiver.stream().packets}
    if focal > 1000:
        assert receiver.stream() == levels
    assert [record.getMessage() for record in caplog.records if record.levelno > logging.INFO] == []


def test_server_error_ends_one_session_only(caplog):
    async def work() -> None:
        async with serving() as server:
            others = [asyncio.create_task(fetch(server.port)) for _ in range(2)]
            failing = asyncio.create_task(fetch(server.port, ReceiverOptions(name="other")))
            assert "the server made an error" in (await failing).finished.reason
            receivers = await asyncio.gather(*others)
            assert [receiver.stream() == STREAM for receiver in receivers] == [True, True]
            assert (await fetch(server.port)).stream() == STREAM

    send = ConnectedClient.send

    def broken(self: ConnectedClient, data: bytes) -> None:
        if message_kind(data) == DATA and decode(data).packet in PROGRAMS["other"].packets:
            raise RuntimeError("broken")
        send(self, data)

    with patch.object(ConnectedClient, "send", broken):
        run(work())
    (line,) = [record for record in caplog.records if record.levelno > logging.INFO]
    assert "broken" in line.getMessage()


def test_stream_is_sent_with_side_information_first_and_few_duplicates():
    async def work() -> None:
        events: list[Any] = []
        async with serving() as server:
            receiver = await fetch(server.port, on_event=events.append)
            assert receiver.finished.reason == "complete"
            assert receiver.stream() == STREAM
            plain = sum(PROGRAMS["scene"].sizes().values()) - PROGRAMS["scene"].sizes()["init_protection"]
            assert receiver.num_bytes < 1.03 * plain
            assert server.core.num_served == 1
        kinds = [type(event) for event in events]
        assert events[0] == Welcomed(len(STREAM.packets), PROGRAMS["scene"].init_segment_bytes, PREVIEW)
        assert kinds.count(PacketArrived) == len(STREAM.packets)
        before = kinds.index(SideInfoArrived)
        assert before < kinds.index(PacketArrived)

    run(work())


@pytest.mark.parametrize("kind", ["random", "burst"])
def test_stream_passes_a_lossy_relay(kind):
    """QUIC delivers side information and feedback recovers packets; random loss does not stop the sender."""

    async def work() -> None:
        rng = random.Random(4)
        lost = bernoulli(0.2, rng) if kind == "random" else at_most(bursts(0.2, 20, rng), 0.3)
        async with serving() as server:
            relay = Relay(server.port, lost, bernoulli(0.2, rng), delay_s=0.005)
            try:
                receiver = await fetch(relay.port)
            finally:
                relay.close()
        assert relay.num_lost > 10
        assert receiver.stream() == STREAM

    run(work())


def test_without_nack_packets_stay_lost_and_side_information_does_not():
    async def work() -> None:
        async with serving() as server:
            relay = Relay(server.port, bernoulli(0.2, random.Random(2)))
            try:
                receiver = await fetch(relay.port, ReceiverOptions(nack=False))
            finally:
                relay.close()
        assert receiver.finished.reason == "sent"
        assert receiver.stream().side_info == STREAM.side_info
        assert relay.num_lost > 0.1 * len(STREAM.packets)  # a full socket may lose more on a busy machine
        assert 0 < len(receiver.stream().packets) < len(STREAM.packets)

    run(work())


def test_many_clients_get_exactly_their_stream():
    async def work() -> None:
        names = ["scene", "other", ""] * 2
        async with serving(ServerLimits(fixed_rate=3e5)) as server:
            receivers = await asyncio.gather(*(fetch(server.port, ReceiverOptions(name=name)) for name in names))
            for name, receiver in zip(names, receivers, strict=True):
                assert receiver.stream() == (OTHER if name == "other" else STREAM)
            assert server.core.num_served == len(names)
            while server.core.num_transfers:  # their close frames are under way
                await asyncio.sleep(0.01)
            missing = await fetch(server.port, ReceiverOptions(name="nothing"))
            assert missing.finished.reason == "no such stream"

    run(work())


def test_limits_are_enforced_and_reported():
    async def work() -> None:
        async with serving(ServerLimits(sessions=0)) as server:
            assert (await fetch(server.port)).finished.reason == "the server is full"
        async with serving(quic=QuicLimits(connections=0)) as server:
            assert "the server is full" in (await fetch(server.port)).finished.reason
            assert server.num_refused == 1
        async with serving(ServerLimits(per_network=2)) as server:  # in separate connections
            reasons = [
                receiver.finished.reason for receiver in await asyncio.gather(*(fetch(server.port) for _ in range(3)))
            ]
            assert sorted(reasons) == ["complete", "complete", "too many transfers from this network"]
        async with serving(ServerLimits(fixed_rate=2e5), QuicLimits(per_network=2)) as server:
            ends = [receiver.finished for receiver in await asyncio.gather(*(fetch(server.port) for _ in range(4)))]
            assert sum(end.ok for end in ends) == 2
            assert sum("your network has its share" in end.reason for end in ends) == 2
            assert server.networks.total() == len(server.connections)

    run(work())


def test_deadline_and_fixed_rate_are_kept():
    async def work() -> None:
        async with serving(ServerLimits(fixed_rate=1e5)) as server:
            receiver = await fetch(server.port, ReceiverOptions(deadline_s=1.2))
        assert receiver.finished.reason == "deadline"
        assert receiver.num_bytes < 2.5e5

    run(work())


def test_only_the_expected_certificate_is_accepted():
    from cryptography.hazmat.primitives.serialization import Encoding

    authority = IDENTITY.certificate.public_bytes(Encoding.PEM)
    stranger = self_signed().certificate.public_bytes(Encoding.PEM)

    async def work() -> None:
        async with serving() as server:
            for trust in (Trust(insecure=True), Trust(authority=authority)):
                assert (await fetch(server.port, ReceiverOptions(name="other"), trust)).stream() == OTHER
            for trust, message in (
                (Trust(), "not trusted: self-signed certificate. Trust it with --fingerprint"),
                (Trust(fingerprint="0" * 64), "another fingerprint"),
                (Trust(authority=stranger), "self-signed"),
            ):
                receiver = await fetch(server.port, None, trust)
                assert not receiver.finished.ok
                assert message in receiver.finished.reason
                assert receiver.stream() is None
            while server.core.num_transfers:
                await asyncio.sleep(0.01)

    run(work())


def test_unreachable_server_is_reported_at_once():
    async def work() -> None:
        async with serving() as server:
            port = server.port
        receiver = await fetch(port)
        assert receiver.finished.reason == "nothing listens there"

    run(work())


@pytest.mark.parametrize("scheme", ["udp", "quic"])
def test_a_wait_for_a_stream_that_has_not_begun_survives_a_restart_of_the_server(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receiver_module, "RECONNECT_AFTER_S", 0.7)

    async def started(programs: dict[str, ServedStream], port: int) -> QuicServer | UdpServer:
        if scheme == "udp":
            return UdpServer(programs, "127.0.0.1", port)
        return await QuicServer(programs, "127.0.0.1", port, identity=IDENTITY).start()

    async def work() -> None:
        waits, interrupted, events = asyncio.Event(), asyncio.Event(), list[object]()
        server = await started({}, 0)
        options, address = ReceiverOptions(name="other"), Address("127.0.0.1", server.port, scheme=scheme)

        def on_event(event: object) -> None:
            events.append(event)
            if isinstance(event, NotBegun):
                waits.set()
            if isinstance(event, Interrupted):
                interrupted.set()

        receive = receive_udp(address, options, on_event) if scheme == "udp" else receive_quic(
            address, options, PINNED, on_event
        )  # fmt: skip
        receiving = asyncio.ensure_future(receive)
        await waits.wait()
        server.close()
        await interrupted.wait()  # "port unreachable" does not end the wait
        server = await started(PROGRAMS, server.port)
        assert (await receiving).stream() == OTHER
        server.close()
        kinds = [type(event) for event in events]
        assert kinds[:2] == [NotBegun, Interrupted]
        assert kinds[kinds.index(Welcomed) - 1] is Resumed

    run(work())


def test_transfers_complete_where_the_port_has_one_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on other systems than Linux."""
    monkeypatch.setattr(sys, "platform", "darwin")

    async def work() -> None:
        udp = UdpServer(PROGRAMS, "127.0.0.1", 0)
        async with serving() as quic:
            assert len(udp._group.sockets) == len(quic._group.sockets) == 1
            receivers = await asyncio.gather(
                receive_udp(Address("127.0.0.1", udp.port), ReceiverOptions()), *(fetch(quic.port) for _ in range(3))
            )
            assert [receiver.stream() == STREAM for receiver in receivers] == [True] * 4
        udp.close()

    run(work())


@pytest.mark.parametrize("num_bytes", [300, MIN_COUNTED_BYTES, MAX_UDP_BYTES])
def test_packets_of_any_size_in_flight_are_fewer_than_those_that_end_a_connection(num_bytes: int) -> None:
    """The path is fast and long, and acknowledges every packet after a second."""
    configuration(is_client=False, alpn=[ALPN], idle_s=1.0)  # registers the controller
    control, most = create_congestion_control(RATE_CONTROL, max_datagram_size=MAX_UDP_BYTES), 0
    for second in range(24):
        packets = []
        while control.bytes_in_flight < control.congestion_window:
            packets.append(SimpleNamespace(sent_bytes=num_bytes, sent_time=float(second)))
            control.on_packet_sent(packet=packets[-1])
        most = max(most, len(packets))
        for packet in packets:
            control.on_packet_acked(now=second + 1.0, packet=packet)
    assert control.congestion_window == WINDOW_BYTES
    assert control.bytes_in_flight == 0
    assert most < 0.7 * MAX_UNACKNOWLEDGED


def test_small_packets_of_clients_count_only_their_bytes_in_flight() -> None:
    """Otherwise a client's small reports would wait for the window."""
    counted = {}
    for is_client in (False, True):
        algorithm = configuration(is_client=is_client, alpn=[ALPN], idle_s=1.0).congestion_control_algorithm
        control = create_congestion_control(algorithm, max_datagram_size=MAX_UDP_BYTES)
        control.on_packet_sent(packet=SimpleNamespace(sent_bytes=60, sent_time=0.0))
        counted[is_client] = control.bytes_in_flight
    assert counted == {False: MIN_COUNTED_BYTES, True: 60}


def test_only_the_first_init_segment_is_also_sent_in_datagrams() -> None:
    """Copies of a second one, as of a live stream, could be taken for symbols of the first."""
    copies = list[int]()
    quic = SimpleNamespace(
        _datagrams_pending=[], send_datagram_frame=lambda data: copies.append(message_kind(data)),
    )  # fmt: skip
    receiver = ConnectedClient(SimpleNamespace(quic=quic), None)
    transfer = ServerTransfer(PROGRAMS["other"], 1, ServerLimits(), 0.0, reliable_init_segment=True)
    for _ in range(2):
        receiver.send(transfer.welcome())
    transfer.set_stream(PROGRAMS["scene"])
    for _ in range(2):
        receiver.send(transfer.welcome())
    assert copies == [WELCOME, WELCOME]


def test_callback_error_is_raised_in_the_caller():
    async def work() -> None:
        async with serving() as server:
            with pytest.raises(FailingCallbackError):
                await fetch(server.port, on_event=fail_on_event)

    run(work())


def test_certificates_are_read_from_files():
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    pem = IDENTITY.certificate.public_bytes(Encoding.PEM)
    key = IDENTITY.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    read = from_pem(pem, key)
    assert read.fingerprint == IDENTITY.fingerprint
    validity = read.certificate.not_valid_after_utc - read.certificate.not_valid_before_utc
    assert validity.days < 14, "browsers want that"
    other = self_signed().key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for certificate, wrong in ((pem, other), (b"x", key), (pem, b"x")):
        with pytest.raises(InvalidValueError):
            from_pem(certificate, wrong)


def test_addresses_and_fingerprints_are_parsed():
    assert parse_url("quic://example.org/scene") == Address("example.org", 4840, "scene", "quic")
    spelled = ":".join(IDENTITY.fingerprint[n : n + 2].upper() for n in range(0, 64, 2))
    assert Trust(fingerprint=spelled) == PINNED
    for wrong in (
        {"fingerprint": "12"},
        {"fingerprint": "x" * 64},
        {"insecure": True, "fingerprint": "0" * 64},
        {"authority": b"?"},
    ):
        with pytest.raises(InvalidValueError):
            Trust(**wrong)


@pytest.mark.parametrize("how", ["restarted", "silent", "another address"])
def test_transfer_resumes_over_another_connection(how):
    """The connection ends, and another one to the same address delivers the missing packets."""

    async def work() -> None:
        events: list[Any] = []
        limits = ServerLimits(fixed_rate=400_000.0, silence_s=1.0)
        first = await QuicServer(PROGRAMS, "127.0.0.1", 0, identity=IDENTITY, limits=limits).start()
        servers, dark, port = [first], [False], first.port
        relay = Relay(port, lambda: dark[0], lambda: dark[0])

        async def disturb() -> None:
            while sum(isinstance(event, PacketArrived) for event in events) < len(STREAM.packets) // 4:
                await asyncio.sleep(0.01)
            if how == "another address":
                relay.rebind()
            elif how == "silent":
                dark[0] = True
                while first.connections or not any(isinstance(event, Interrupted) for event in events):
                    await asyncio.sleep(0.01)
                dark[0] = False
            else:
                servers.pop().close()
                while not any(isinstance(event, Interrupted) for event in events):
                    await asyncio.sleep(0.01)
                servers.append(await QuicServer(PROGRAMS, "127.0.0.1", port, identity=IDENTITY, limits=limits).start())

        disturbing = asyncio.create_task(disturb())
        try:
            receiver = await fetch(relay.port, ReceiverOptions(silence_s=1.0), on_event=events.append)
            await disturbing
        finally:
            disturbing.cancel()
            relay.close()
            for server in servers:
                server.close()
        assert receiver.finished.reason == "complete"
        assert receiver.stream() == STREAM
        kept = [event.kept for event in events if isinstance(event, Resumed)]
        assert all(kept)
        assert kept or how == "another address"  # QUIC migrates by itself

    run(work())


@pytest.mark.parametrize(
    ("returns", "error"),
    [
        (True, OSError(errno.ENETUNREACH, "Network is unreachable")),
        (False, OSError(errno.ENETUNREACH, "Network is unreachable")),
        (False, OSError("Network is unreachable")),
    ],
)
def test_transfer_survives_a_time_without_a_route_to_the_server(
    monkeypatch: pytest.MonkeyPatch, returns: bool, error: OSError
) -> None:
    """No socket can be connected then. If the outage does not end, the received part is kept."""
    opened, refused = 0, 0

    def open_socket(family: Any, target: Any) -> Any:
        nonlocal opened, refused
        if opened and (refused < 2 or not returns):
            refused += 1
            raise error
        opened += 1
        return connected_socket(family, target)

    monkeypatch.setattr(client, "connected_socket", open_socket)

    async def work() -> None:
        async with serving(ServerLimits(fixed_rate=400_000.0)) as server:
            count = 0

            def note(event: Any) -> None:
                nonlocal count
                count += isinstance(event, PacketArrived)
                if count == len(STREAM.packets) // 4 and opened == 1:
                    for connection in list(server.connections):
                        connection.end(FULL, "the path is gone")

            receiver = await fetch(server.port, ReceiverOptions(reconnect_s=10.0 if returns else 3.0), on_event=note)
        assert refused >= 2
        if returns:
            assert (receiver.finished.reason, receiver.stream()) == ("complete", STREAM)
        else:
            assert receiver.finished.reason == "the server fell silent; Network is unreachable"
            assert 0 < len(receiver.stream().packets) < len(STREAM.packets)

    run(work())


@pytest.mark.parametrize("route", [True, False])
def test_deadline_ends_a_transfer_between_two_connections(monkeypatch: pytest.MonkeyPatch, route: bool) -> None:
    opened, has_ended = 0, False

    def open_socket(family: Any, target: Any) -> Any:
        nonlocal opened
        opened += 1
        if has_ended and not route:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")
        return connected_socket(family, target)

    monkeypatch.setattr(client, "connected_socket", open_socket)
    for pause in ("MIN_PAUSE_S", "MAX_PAUSE_S"):
        monkeypatch.setattr(client, pause, 1000.0 if route else 0.01)

    async def work() -> None:
        async with serving(ServerLimits(fixed_rate=400_000.0)) as server:

            def end_connections(event: Any) -> None:
                nonlocal has_ended
                if isinstance(event, PacketArrived):
                    has_ended = True
                    for connection in list(server.connections):
                        connection.end(FULL, "the path is gone")

            options = ReceiverOptions(deadline_s=2.0, reconnect_s=2000.0)
            receiver = await fetch(server.port, options, on_event=end_connections)
        assert receiver.finished.reason == "deadline"
        assert has_ended
        assert (opened > 1) == (not route)

    run(work())


def test_unreturning_server_ends_the_transfer():
    async def work() -> None:
        events: list[Any] = []
        server = await QuicServer(
            PROGRAMS, "127.0.0.1", 0, identity=IDENTITY, limits=ServerLimits(fixed_rate=200_000.0)
        ).start()

        def note(event: Any) -> None:
            events.append(event)
            if isinstance(event, SideInfoArrived):
                server.close()

        receiver = await fetch(server.port, ReceiverOptions(silence_s=0.5, reconnect_s=1.5), on_event=note)
        assert receiver.finished.reason != "complete"
        assert receiver.finished.ok

    run(work())
