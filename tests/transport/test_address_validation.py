"""Address validation of the QUIC server: a flood of forged Initial packets costs little and delays nobody for long."""

import asyncio
import itertools
import logging
import os
import random
import socket
import ssl

import pytest

from splatwire.transport import ReceiverOptions
from transport.relay import Relay

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.asyncio.server import QuicServer as AioquicServer
from aioquic.buffer import Buffer
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.connection import QuicConnection
from aioquic.quic.packet import QuicProtocolVersion, encode_quic_retry, pull_quic_header

from splatwire.transport.protocol import response_budget
from splatwire.transport.protocol.response_budget import MAX_RESPONSES
from splatwire.transport.quic import client as client_module
from splatwire.transport.quic import server as server_module
from splatwire.transport.quic.address_validation import (
    TOKEN_LIFETIME_S,
    Initial,
    RetryTokens,
    parse_initial,
)
from splatwire.transport.quic.common import ALPN, MAX_PROBE_INTERVAL_S, configuration, limit_backoff
from splatwire.transport.quic.server import RETRY_HANDSHAKES
from splatwire.transport.socket_group import TOKEN_PREFIX, TURN_DATAGRAMS, DatagramClass
from transport.test_quic import IDENTITY, OTHER, fetch, run, serving

VERSIONS = (QuicProtocolVersion.VERSION_1, QuicProtocolVersion.VERSION_2)
HERE = ("192.0.2.1", 4000)


def forged(rng: random.Random, token: bytes = b"") -> bytes:
    """A forged Initial packet with a valid header and random content."""
    size = 1200 - 26 - len(token)
    head = b"\xc0\0\0\0\1\x08" + rng.randbytes(8) + b"\x08" + rng.randbytes(8)
    return head + (0x4000 | len(token)).to_bytes(2, "big") + token + (0x4000 | size).to_bytes(2, "big") + bytes(size)


@pytest.mark.parametrize("version", VERSIONS)
def test_initial_packets_of_clients_are_parsed_and_answered_with_a_retry(version: int, monkeypatch: pytest.MonkeyPatch):
    settings = QuicConfiguration(is_client=True, server_name="localhost", original_version=version)
    settings.supported_versions = [version]
    client = QuicConnection(configuration=settings)
    client.connect(HERE, now=0.0)
    initial = parse_initial(client.datagrams_to_send(now=0.0)[0][0])
    assert initial is not None
    assert (initial.version, initial.source, initial.token) == (version, client.host_cid, b"")
    tokens = RetryTokens()
    monkeypatch.setattr(os, "urandom", bytes)
    retry = tokens.retry_packet(initial, HERE, 5.0)
    token = tokens.create_token(
        address=HERE, original_destination_connection_id=initial.destination, retry_source_connection_id=bytes(8),
        now=5.0,
    )  # fmt: skip
    expected = encode_quic_retry(
        version=version, source_cid=bytes(8), destination_cid=initial.source,
        original_destination_cid=initial.destination, retry_token=token,
    )  # fmt: skip
    assert (retry[0] & 0xF0, retry[1:-16]) == (expected[0] & 0xF0, expected[1:-16])
    client.receive_datagram(retry, HERE, now=0.1)  # which checks the integrity tag
    repeated = parse_initial(client.datagrams_to_send(now=0.1)[0][0])
    assert repeated is not None
    assert (repeated.token, repeated.destination) == (token, bytes(8))
    assert tokens.is_valid(repeated, HERE, 5.1)


@pytest.mark.parametrize(
    ("address", "destination", "now", "flipped"),
    [
        (("192.0.2.2", 4000), b"retried!", 5.0, None),
        (("192.0.2.1", 4001), b"retried!", 5.0, None),
        (HERE, b"others!!", 5.0, None),
        (HERE, b"retried!", 5.1 + TOKEN_LIFETIME_S, None),
        *((HERE, b"retried!", 5.0, place) for place in (0, 4, 9, 23, 24, 31)),
    ],
)
def test_tokens_of_others_and_changed_tokens_are_refused(address, destination, now, flipped):
    tokens = RetryTokens()
    token = bytearray(
        tokens.create_token(
            address=HERE, original_destination_connection_id=b"original", retry_source_connection_id=b"retried!",
            now=5.0,
        )
    )  # fmt: skip
    assert tokens.is_valid(Initial(1, b"retried!", b"", bytes(token)), HERE, 6.0)
    if flipped is not None:
        token[flipped] ^= 1
    assert not tokens.is_valid(Initial(1, destination, b"", bytes(token)), address, now)


def test_random_datagrams_are_no_initial_packets_or_parse_within_bounds():
    rng = random.Random(1)
    for _ in range(20_000):
        data = bytearray(forged(rng, rng.randbytes(rng.randrange(90))))
        for _ in range(rng.randrange(4)):
            data[rng.randrange(60)] = rng.choice((0, 255, rng.randrange(256)))
        initial = parse_initial(bytes(data[: rng.choice((len(data), len(data), rng.randrange(9, len(data))))]))
        if initial is not None:
            assert max(len(initial.destination), len(initial.source)) <= 20
            assert bytes(data).find(initial.token) >= 0


def test_a_flood_of_initial_packets_reaches_no_cryptography(monkeypatch, caplog):
    """Forged packets, half of them with forged tokens: few reach aioquic, and a client is served meanwhile."""
    passed = []
    original = AioquicServer.datagram_received
    monkeypatch.setattr(
        AioquicServer, "datagram_received", lambda self, *args: (passed.append(args), original(self, *args))
    )

    async def work() -> None:
        rng, sent = random.Random(2), 0
        async with serving() as server:
            with caplog.at_level(logging.WARNING):
                fetching = asyncio.ensure_future(fetch(server.port, ReceiverOptions(name="other")))
                while not fetching.done():
                    for n in range(100):
                        token = TOKEN_PREFIX + rng.randbytes(50) if n % 2 else rng.randbytes(n % 3)
                        server._endpoint.datagram_received(forged(rng, token), (f"192.0.2.{n}", rng.randrange(1, 9999)))
                    sent += 100
                    await asyncio.sleep(0)
            assert (await fetching).stream() == OTHER
            assert sent > 1000
            strange = [data for data, address in passed if address[0].startswith("192.")]
            assert 0 < len(strange) <= RETRY_HANDSHAKES
            assert server.num_dropped >= sent // 2
            (line,) = [record.getMessage() for record in caplog.records]
            assert line.startswith("connection attempts dropped count=")

    run(work())


def test_initial_packets_beyond_the_budget_of_responses_are_dropped_without_parsing(monkeypatch):
    parsed = []
    monkeypatch.setattr(server_module, "parse_initial", lambda data: (parsed.append(data), parse_initial(data))[1])
    monkeypatch.setattr(server_module, "RETRY_HANDSHAKES", 0)
    monkeypatch.setattr(response_budget, "WINDOW_S", 1000.0)

    async def work() -> None:
        rng = random.Random(3)
        async with serving() as server:
            for n in range(4 * MAX_RESPONSES):
                server._endpoint.datagram_received(forged(rng, rng.randbytes(n % 40)), ("192.0.2.7", 1024 + n))
            assert (len(parsed), server.num_dropped) == (MAX_RESPONSES // 2, 7 * MAX_RESPONSES // 2)
            assert (await fetch(server.port, ReceiverOptions(name="other"))).stream() == OTHER
            server._endpoint.datagram_received(forged(rng, TOKEN_PREFIX + rng.randbytes(28)), ("192.0.2.7", 1024))
            assert len(parsed) > MAX_RESPONSES // 2 + 2  # packets with a token are verified

    run(work())


def test_many_datagrams_are_read_in_one_turn_of_the_event_loop(monkeypatch):
    async def work() -> None:
        async with serving() as server:
            seen = []
            monkeypatch.setattr(server._endpoint, "datagram_received", lambda data, address: seen.append(data))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                for n in range(TURN_DATAGRAMS[DatagramClass.KNOWN]):
                    sender.sendto(bytes([n]), ("127.0.0.1", server.port))
            for _ in range(3):
                await asyncio.sleep(0)
            assert len(seen) == TURN_DATAGRAMS[DatagramClass.KNOWN]

    run(work())


def test_datagrams_that_the_socket_does_not_accept_are_sent_later(monkeypatch):
    async def work() -> None:
        async with serving() as server:
            transport, refused = server._endpoint._transport, []

            class Full:
                def sendto(self, data: bytes, address: object) -> int:
                    refused.append(data)
                    raise BlockingIOError

                def __getattr__(self, name: str) -> object:
                    return getattr(server._socket, name)

            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
                client.bind(("127.0.0.1", 0))
                client.settimeout(10)
                monkeypatch.setattr(transport, "_socket", Full())
                for n in range(2000):
                    transport.sendto(bytes([n % 256]), client.getsockname())
                assert len(refused) == 1
                monkeypatch.setattr(transport, "_socket", server._socket)
                transport._writable()
                assert [client.recv(10)[0] for _ in range(200)] == list(range(200))

    run(work())


def test_probes_of_a_handshake_follow_each_other_fast():
    settings = configuration(is_client=True, alpn=[ALPN], idle_s=10.0)
    settings.server_name = "localhost"
    client, now, times = QuicConnection(configuration=settings), 0.0, []
    client.connect(HERE, now=now)
    while now < 5.0:
        if client.datagrams_to_send(now=now):
            times.append(now)
        limit_backoff(client)
        now = client.get_timer()
        client.handle_timer(now=now)
    gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert max(gaps) <= MAX_PROBE_INTERVAL_S * 1.01


@pytest.mark.parametrize("round_trip", [0.0002, 0.02, 0.3])
def test_a_client_that_disappears_in_the_handshake_gets_few_probes(round_trip: float):
    """It confirms the server's first packet only; a short round trip must not make the server repeat itself at once."""
    settings = [configuration(is_client=is_client, alpn=[ALPN], idle_s=10.0) for is_client in (True, False)]
    settings[0].server_name, settings[0].verify_mode = "localhost", ssl.CERT_NONE
    settings[1].certificate, _, settings[1].private_key = IDENTITY
    client, now = QuicConnection(configuration=settings[0]), 0.0
    client.connect(HERE, now=now)
    server = QuicConnection(
        configuration=settings[1], original_destination_connection_id=client.original_destination_connection_id
    )
    server.receive_datagram(client.datagrams_to_send(now=now)[0][0], HERE, now=now)
    for data, _ in server.datagrams_to_send(now=now):
        client.receive_datagram(data, HERE, now=round_trip / 2)
    data = client.datagrams_to_send(now=round_trip / 2)[0][0]
    size = pull_quic_header(Buffer(data=data)).packet_length
    now = round_trip
    server._network_paths[0].is_validated = True  # as after a Retry
    server.receive_datagram(data[:size].ljust(1200, b"\0"), HERE, now=now)
    num_probes = 0
    while server.get_timer() is not None and now < 30.0:
        num_probes += len(server.datagrams_to_send(now=now))
        limit_backoff(server)
        now = max(now, server.get_timer() or 30.0)
        server.handle_timer(now=now)
    assert server._loss._rtt_initialized
    assert 5 < num_probes < 150
    assert now < 12.0


@pytest.mark.parametrize("busy", [False, True])
def test_a_client_with_a_token_of_another_server_is_served(busy, monkeypatch):
    """Such as a browser that visited another server at this address; it gets a Retry while the server is busy."""

    def with_token(**options: object) -> QuicConfiguration:
        settings = configuration(**options)
        settings.token = b"token of another server"
        return settings

    monkeypatch.setattr(client_module, "configuration", with_token)
    monkeypatch.setattr(server_module, "RETRY_HANDSHAKES", 0 if busy else RETRY_HANDSHAKES)

    async def work() -> None:
        async with serving() as server:
            assert (await fetch(server.port, ReceiverOptions(name="other"))).stream() == OTHER
            assert server.num_dropped == 0

    run(work())


@pytest.mark.slow
def test_a_client_connects_again_if_its_handshake_times_out(monkeypatch: pytest.MonkeyPatch):
    attempts, original = [], client_module.connected_socket
    monkeypatch.setattr(client_module, "connected_socket", lambda *args: (attempts.append(args), original(*args))[1])

    async def work() -> None:
        async with serving() as server:
            passing = False
            relay = Relay(server.port, lambda: not passing, lambda: not passing)
            options = ReceiverOptions(name="other", silence_s=0.3)
            fetching = asyncio.ensure_future(fetch(relay.port, options))
            while len(attempts) < 2:
                assert not fetching.done()
                await asyncio.sleep(0.01)
            passing = True
            assert (await fetching).finished.reason == "complete"
            relay.close()

    run(work())


@pytest.mark.slow
def test_a_transfer_completes_over_a_path_that_loses_half_of_its_packets():
    async def work() -> None:
        rng = random.Random(6)
        async with serving() as server:
            relay = Relay(server.port, lambda: rng.random() < 0.5, lambda: rng.random() < 0.5, 0.005)
            receiver = await fetch(relay.port, ReceiverOptions(name="other"))
            assert receiver.finished.reason == "complete"
            assert receiver.stream() == OTHER
            relay.close()

    run(work())
