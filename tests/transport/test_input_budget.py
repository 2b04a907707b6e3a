"""Processor time of a QUIC server for the datagrams of each client."""

import asyncio
import logging
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.quic.connection import QuicConnection

from splatwire.transport import ReceiverOptions
from splatwire.transport.protocol.admission import network_of
from splatwire.transport.quic import input_budget
from splatwire.transport.quic import server as quic_server
from splatwire.transport.quic.common import ALPN, length_prefixed
from splatwire.transport.quic.input_budget import (
    EARNED_FACTOR,
    HANDSHAKE_RESERVE_S,
    MAX_CREDIT_S,
    MAX_DATAGRAM_S,
    MAX_HANDSHAKE_CREDIT_S,
    MAX_HANDSHAKE_SHARE,
    MAX_NETWORK_SHARE,
    MAX_SHARE,
    MAX_START_CREDIT_S,
    MIN_HANDSHAKE_SHARE,
    START_CREDIT_S,
    START_SHARE,
    InputBudget,
    NetworkBudgets,
)
from transport.test_quic import STREAM, fetch, run, serving
from transport.test_quic_hostile import close_client, connected, until


def spent_share(num_connections: int, seconds: float = 100.0, cost: float = 1e-3) -> float:
    """Share of the time that a connection spends if its datagrams arrive without end."""
    budget, spent = InputBudget(START_CREDIT_S, 0.0), 0.0
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
    budget, share = InputBudget(START_CREDIT_S, 0.0), min(MAX_SHARE, MAX_NETWORK_SHARE / num_connections)
    spend(budget, START_CREDIT_S)
    budget.spend(0.5)
    assert budget.is_spent(num_connections, 0.9 * MAX_DATAGRAM_S / share)
    assert not budget.is_spent(num_connections, 1.1 * MAX_DATAGRAM_S / share)


def test_time_for_sending_data_earns_time_for_datagrams() -> None:
    budget = InputBudget(START_CREDIT_S, 0.0)
    spend(budget, START_CREDIT_S)
    assert budget.is_spent(1, 0.0)
    budget.earn(0.01)
    assert not budget.is_spent(1, 0.0)
    spend(budget, 0.01 * EARNED_FACTOR)
    assert budget.is_spent(1, 0.0)
    budget.earn(100.0)
    spend(budget, MAX_CREDIT_S)
    assert budget.is_spent(1, 0.0)


@pytest.mark.parametrize("lifetime_s", [0.07, 1.0])
def test_a_client_that_connects_again_and_again_gets_no_more_time(lifetime_s: float) -> None:
    budgets, spent, seconds, cost = NetworkBudgets(32), 0.0, 100.0, 1e-3
    steps_per_life = round(lifetime_s / cost)
    for begin in range(0, round(seconds / cost), steps_per_life):
        budget = budgets.open("here", begin * cost)
        for step in range(begin, begin + steps_per_life):
            while not budget.is_spent(1, step * cost):
                budget.spend(cost)
                spent += cost
        budgets.close("here", budget, (begin + steps_per_life) * cost)
    assert spent <= MAX_START_CREDIT_S + (MAX_SHARE + START_SHARE) * seconds + seconds / lifetime_s * cost


def test_clients_of_a_network_get_their_share_while_another_client_connects_again_and_again() -> None:
    budgets, seconds, cost = NetworkBudgets(32), 10.0, 1e-3
    while budgets.open("here", 0.0).credit > 0:
        pass
    honest, spent = budgets.open("here", 0.0), 0.0
    for step in range(round(seconds / cost)):
        now = step * cost
        other = budgets.open("here", now)
        while not other.is_spent(2, now):
            other.spend(cost)
        if not honest.is_spent(2, now):
            honest.spend(cost)
            spent += cost
        budgets.close("here", other, now)
    assert spent == pytest.approx(MAX_SHARE * seconds, rel=0.1)


def test_an_ended_connection_gives_its_credit_or_debt_to_its_network() -> None:
    budgets = NetworkBudgets(32)
    connections = [budgets.open("here", 0.0) for _ in range(round(MAX_START_CREDIT_S / START_CREDIT_S))]
    assert budgets.open("here", 0.0).credit == pytest.approx(0.0)
    budgets.close("here", connections[0], 0.0)
    budgets.close("here", connections[0], 0.0)  # gives nothing twice
    connections[1].spend(MAX_DATAGRAM_S)
    connections[1].credit -= START_CREDIT_S
    budgets.close("here", connections[1], 0.0)
    assert budgets.open("here", 0.0).credit == pytest.approx(START_CREDIT_S - MAX_DATAGRAM_S)
    assert budgets.open("elsewhere", 0.0).credit == START_CREDIT_S


def test_debt_of_ended_connections_keeps_start_credit_from_their_network_for_seconds_only() -> None:
    budgets = NetworkBudgets(32)
    for _ in range(10_000):
        budget = budgets.open("here", 0.0)
        budget.spend(MAX_DATAGRAM_S)
        budgets.close("here", budget, 0.0)
    paid_at = MAX_START_CREDIT_S / START_SHARE
    assert budgets.open("here", 0.9 * paid_at).credit == 0.0
    assert budgets.open("here", paid_at + 1.01 * START_CREDIT_S / START_SHARE).credit == pytest.approx(START_CREDIT_S)


@pytest.mark.parametrize(("per_network", "share"), [(1, MIN_HANDSHAKE_SHARE), (100, 0.15), (9999, MAX_HANDSHAKE_SHARE)])
def test_time_for_handshakes_is_limited_per_network(per_network: int, share: float) -> None:
    budgets, num_begun, cost = NetworkBudgets(per_network), 0, 5e-3
    assert HANDSHAKE_RESERVE_S < MAX_HANDSHAKE_CREDIT_S
    while budgets.may_begin("here", 0.0):
        budgets.spend("here", cost, 0.0)
        num_begun += 1
    assert num_begun * cost == pytest.approx(MAX_HANDSHAKE_CREDIT_S - HANDSHAKE_RESERVE_S, abs=2 * cost)
    assert budgets.may_begin("there", 0.0)
    assert budgets.may_continue("here", 0.0)
    for _ in range(round(HANDSHAKE_RESERVE_S / cost) + 1):
        budgets.spend("here", cost, 0.0)
    assert not budgets.may_continue("here", 0.0)
    assert budgets.may_continue("here", 2 * cost / share)
    assert not budgets.may_begin("here", 2 * cost / share)
    assert budgets.may_begin("here", (HANDSHAKE_RESERVE_S + 2 * cost) / share)


def test_memory_for_counted_networks_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_budget, "MAX_COUNTED_NETWORKS", 100)
    budgets = NetworkBudgets(32)
    for number in range(1000):
        budgets.spend(number, MAX_DATAGRAM_S, 0.0)
        budgets.spend("active", 0.4 * MAX_DATAGRAM_S, 0.0)
        assert len(budgets._networks) <= 100
    assert not budgets.may_continue("active", 0.0)  # dropped networks are those that are idle


@pytest.mark.slow
def test_handshakes_of_a_network_wait_until_it_has_time_for_them_again() -> None:
    async def work() -> None:
        async with serving() as server:
            here, budgets = network_of(("127.0.0.1", 1)), server.budgets
            budgets._handshake_share = 0.0
            while budgets.may_begin(here, asyncio.get_running_loop().time()):
                budgets.spend(here, MAX_DATAGRAM_S, asyncio.get_running_loop().time())
            fetching = asyncio.ensure_future(fetch(server.port))
            await until(lambda: server.num_dropped > 0)
            assert not server.connections
            budgets._handshake_share = MAX_HANDSHAKE_SHARE
            assert (await fetching).stream() == STREAM

    run(work())


@pytest.mark.slow
def test_a_connection_that_ends_gives_its_start_credit_back_to_its_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_budget, "START_SHARE", 0.0)
    monkeypatch.setattr(quic_server, "time", SimpleNamespace(thread_time=lambda: 0.0))  # datagrams take no time

    async def work() -> None:
        async with serving() as server:
            credit = server.budgets._credit_of(network_of(("127.0.0.1", 1)), 0.0)
            client = await connected(server.port, ALPN)
            await until(lambda: credit.starts == pytest.approx(MAX_START_CREDIT_S - START_CREDIT_S))
            await close_client(client)
            await until(lambda: credit.starts == pytest.approx(MAX_START_CREDIT_S))

    run(work())


@pytest.mark.slow
def test_reconnecting_clients_share_the_start_credit_of_their_network(monkeypatch: pytest.MonkeyPatch) -> None:
    cost, num_connections = 0.01, 6
    monkeypatch.setattr(input_budget, "MAX_START_CREDIT_S", 2 * START_CREDIT_S)
    for share in ("MAX_SHARE", "MAX_NETWORK_SHARE", "START_SHARE"):  # only the start credit remains
        monkeypatch.setattr(input_budget, share, 0.0)
    clock, seen = SimpleNamespace(now=0.0), SimpleNamespace(passed=0)
    original = QuicConnection.receive_datagram

    def receive(self: QuicConnection, data: bytes, address: Any, now: float) -> None:
        if not self._is_client and self._handshake_complete:
            clock.now += cost
            seen.passed += 1
        original(self, data, address, now)

    monkeypatch.setattr(QuicConnection, "receive_datagram", receive)
    monkeypatch.setattr(quic_server, "time", SimpleNamespace(thread_time=lambda: clock.now))

    async def work() -> None:
        async with serving() as server:
            for _ in range(num_connections):
                client = await connected(server.port, ALPN)
                await until(lambda: any(other._budget is not None for other in server.connections))
                (connection,) = server.connections
                recovery = client.quic._loss
                recovery._cc.congestion_window, recovery._pacer.packet_time = 1 << 40, None
                before = seen.passed + server.num_excess
                for _datagram in range(20):
                    client.quic.send_datagram_frame(bytes(1000))
                    client.transmit()
                    await asyncio.sleep(0)
                await until(lambda before=before: seen.passed + server.num_excess >= before + 20)
                connection.end(0, "the next one")
                await close_client(client)
            assert seen.passed * cost <= 2 * START_CREDIT_S + num_connections * cost

    run(work())


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
            await until(lambda: server.connections and next(iter(server.connections))._handler.has_request)
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
