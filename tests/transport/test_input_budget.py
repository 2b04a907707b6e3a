"""Processor time of a QUIC server for the datagrams of each client."""

import asyncio
import logging
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.quic.connection import QuicConnection

from splatwire.transport import ReceiverOptions
from splatwire.transport.quic import input_budget
from splatwire.transport.quic import server as quic_server
from splatwire.transport.quic.common import ALPN, length_prefixed
from splatwire.transport.quic.input_budget import (
    EARNED_FACTOR,
    HANDSHAKE_WINDOW_S,
    MAX_CREDIT_S,
    MAX_DATAGRAM_S,
    MAX_HANDSHAKE_S,
    MAX_NETWORK_SHARE,
    MAX_SHARE,
    START_CREDIT_S,
    HandshakeTime,
    InputBudget,
)
from transport.test_quic import STREAM, fetch, run, serving
from transport.test_quic_hostile import close_client, connected, until


def spent_share(num_connections: int, seconds: float = 100.0, cost: float = 1e-3) -> float:
    """Share of the time that a connection spends if its datagrams arrive without end."""
    budget, spent = InputBudget(0.0), 0.0
    for step in range(round(seconds / cost)):
        if not budget.is_spent(num_connections, step * cost):
            budget.spend(cost)
            spent += cost
    return spent / seconds


@pytest.mark.parametrize("num_connections", [1, 3, 30])
def test_connections_of_a_network_share_processor_time(num_connections: int) -> None:
    share = min(MAX_SHARE, MAX_NETWORK_SHARE / num_connections)
    assert spent_share(num_connections) == pytest.approx(share, rel=0.1, abs=START_CREDIT_S / 100)


def spend(budget: InputBudget, seconds: float) -> None:
    """Spends processor time on several datagrams."""
    while seconds > 0:
        budget.spend(min(seconds, MAX_DATAGRAM_S))
        seconds -= min(seconds, MAX_DATAGRAM_S)


@pytest.mark.parametrize("num_connections", [1, 30])
def test_one_slow_datagram_stops_a_connection_briefly(num_connections: int) -> None:
    """Garbage collections and the first request for a large stream take longer than any content of a datagram."""
    budget, share = InputBudget(0.0), min(MAX_SHARE, MAX_NETWORK_SHARE / num_connections)
    spend(budget, START_CREDIT_S)
    budget.spend(0.5)
    assert budget.is_spent(num_connections, 0.9 * MAX_DATAGRAM_S / share)
    assert not budget.is_spent(num_connections, 1.1 * MAX_DATAGRAM_S / share)


def test_time_for_sending_data_earns_time_for_datagrams() -> None:
    budget = InputBudget(0.0)
    spend(budget, START_CREDIT_S)
    assert budget.is_spent(1, 0.0)
    budget.earn(0.01)
    assert not budget.is_spent(1, 0.0)
    spend(budget, 0.01 * EARNED_FACTOR)
    assert budget.is_spent(1, 0.0)
    budget.earn(100.0)
    spend(budget, MAX_CREDIT_S)
    assert budget.is_spent(1, 0.0)


def test_time_for_handshakes_is_limited_per_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_budget, "MAX_COUNTED_NETWORKS", 100)
    budget = HandshakeTime()
    budget.spend("here", MAX_HANDSHAKE_S)
    assert budget.is_spent("here", 0.0) is False  # a window begins with the first test
    budget.spend("here", MAX_HANDSHAKE_S)
    assert budget.is_spent("here", HANDSHAKE_WINDOW_S - 0.1)
    assert not budget.is_spent("there", 0.0)
    assert not budget.is_spent("here", HANDSHAKE_WINDOW_S)
    for number in range(1000):
        assert not budget.is_spent(number, HANDSHAKE_WINDOW_S)
        budget.spend(number, MAX_HANDSHAKE_S)
        assert len(budget._seconds) <= 101


@pytest.mark.slow
def test_a_client_that_floods_its_connection_gets_a_bounded_share_and_others_are_served(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cost, num_floods = 0.01, 3000
    clock, hostile = SimpleNamespace(now=0.0), set[int]()
    passed: list[int] = []
    original = QuicConnection.receive_datagram

    def receive(self: QuicConnection, data: bytes, address: Any, now: float) -> None:
        if not self._is_client and address[1] in hostile:
            clock.now += cost
            passed.append(len(data))
        original(self, data, address, now)

    monkeypatch.setattr(QuicConnection, "receive_datagram", receive)
    monkeypatch.setattr(quic_server, "time", SimpleNamespace(thread_time=lambda: clock.now))

    async def work() -> None:
        async with serving() as server:
            client = await connected(server.port, ALPN)
            client.quic.send_stream_data(0, length_prefixed(b"\0"))
            client.transmit()
            await until(lambda: server.connections and next(iter(server.connections))._sessions.has_request)
            recovery = client.quic._loss  # most of its datagrams get no acknowledgement
            recovery._cc.congestion_window, recovery._pacer.packet_time = 1 << 40, None
            monkeypatch.setattr(recovery, "on_ack_received", lambda **_: None)
            began = asyncio.get_running_loop().time()
            hostile.add(client._transport.get_extra_info("sockname")[1])
            fetching = asyncio.ensure_future(fetch(server.port, ReceiverOptions(name="scene")))
            for _ in range(num_floods):
                client.quic.send_datagram_frame(bytes(100))
                client.transmit()
                await asyncio.sleep(0)
            assert (await fetching).stream() == STREAM
            await until(lambda: len(passed) + server.num_excess >= num_floods / 2)
            elapsed = asyncio.get_running_loop().time() - began
            assert 0 < len(passed) * cost <= START_CREDIT_S + MAX_SHARE * elapsed + 4 * cost
            assert server.num_excess > 1000
            await close_client(client)

    with caplog.at_level(logging.WARNING):
        run(work())
    messages = [record.getMessage() for record in caplog.records]
    assert messages[0] == "excess datagrams dropped count=1000"
    assert all(message.startswith("excess datagrams dropped ") for message in messages)  # a second one after 10 s
