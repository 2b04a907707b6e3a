"""Limits of sessions, starts and answers for one client among many, independent of its ports and tokens."""

import asyncio
import logging
import random
import tracemalloc
from collections import Counter
from typing import Any

import pytest

from splatwire.errors import InvalidValueError
from splatwire.transport import ReceiverOptions, Server, ServerLimits, make_served_stream
from splatwire.transport.protocol.admission import (
    MAX_NETWORKS,
    WINDOW_S,
    ConnectionSlots,
    StartRateLimiter,
    choose_eviction,
    largest_holder,
    network_of,
)
from splatwire.transport.protocol.messages import Bye, Challenge, Feedback, Hello, Refuse, Request, Welcome
from splatwire.transport.protocol.sender import MAX_STARTS_FACTOR, TOO_MANY, UNKNOWN_STREAM
from splatwire.transport.protocol.transfer import MAX_WELCOMES, WELCOME_INTERVAL_S
from splatwire.transport.protocol.wire import decode, encode
from transport.network import SECRET, datagram_stream

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
PROGRAM = make_served_stream(datagram_stream(num_anchors=500, side_bytes=3000), preview=bytes(1018))
LIMITS = ServerLimits(sessions=64, per_network=4)
Address = tuple[str, int]


def server(limits: ServerLimits = LIMITS) -> Server:
    return Server({"scene": PROGRAM}, secret=SECRET, random=random.Random(0).randbytes, limits=limits)


def token(of: Server, address: Address, nonce: int, now: float, name: str = "") -> bytes:
    message = decode(of.receive(address, encode(Hello(nonce, name)), now))
    assert isinstance(message, Challenge)
    return message.token


def begin(of: Server, address: Address, nonce: int, now: float) -> Welcome | Refuse:
    return decode(of.receive(address, encode(Request(nonce, token(of, address, nonce, now), "")), now))


def test_a_network_is_an_ipv4_address_or_a_prefix_of_ipv6():
    def alike(one: str, other: str) -> bool:
        return network_of((one, 1)) == network_of((other, 2, 0, 0))

    assert alike("192.0.2.1", "192.0.2.1")
    assert alike("192.0.2.1", "::ffff:192.0.2.1")
    assert not alike("192.0.2.1", "192.0.2.2")
    assert alike("2001:db8::1", "2001:db8::ffff:ffff:ffff:ffff")
    assert alike("fe80::1%eth0", "fe80::2%eth0")
    assert not alike("2001:db8::1", "2001:db8:0:1::1")
    assert not alike("::1", "127.0.0.1")
    assert [network_of(address) for address in ("client", 7, ("pipe", 1), ())] == [("client",), (7,), ("pipe",), ((),)]


@pytest.mark.parametrize("host", ["192.0.2.{}", "2001:db8::{}"])
def test_one_network_holds_at_most_its_share_of_sessions(host: str):
    serving, taken = server(), Counter[type]()
    for port in range(200):
        mine = host.format(1 if "." in host else hex(port)[2:])
        taken[type(begin(serving, (mine, port), port, 0.0))] += 1
    assert taken == {Welcome: 4, Refuse: 196}
    assert serving.num_transfers == 4
    assert isinstance(begin(serving, ("198.51.100.9", 5), 5, 0.0), Welcome)


def test_all_networks_share_the_session_limit():
    serving = server()
    answers = [begin(serving, (f"192.0.2.{n}", 1), n, 0.0) for n in range(100)]
    assert sum(isinstance(answer, Welcome) for answer in answers) == serving.num_transfers == 64


@pytest.mark.parametrize("hosts", ["192.0.2.{0}", "2001:db8:0:{0:x}::1", "2001:db8:{0:x}::1"])
def test_client_with_many_networks_yields_sessions_to_others(hosts: str):
    """One session for each of many addresses of a /24, a /48 or a /32 of one owner."""
    serving = server(ServerLimits(sessions=64, per_network=4, silence_s=1e9))
    theirs = [(hosts.format(n), n) for n in range(1, 200)]
    assert sum(isinstance(begin(serving, here, here[1], 0.0), Welcome) for here in theirs) == 64
    for n, host in enumerate(["198.51.100.1", "2001:db9::1", "198.51.100.2", "203.0.113.1"] * 4):
        assert isinstance(begin(serving, (host, n), 1000 + n, 1.0), Welcome), host
    assert serving.num_transfers == 64
    assert isinstance(begin(serving, theirs[-1], 5000, 1.0), Refuse)
    assert sum(address in theirs for address, _ in serving._transfers) == 48


def test_sessions_are_shared_between_then_within_wide_networks():
    one, two, three = ((("a", 1), ("a", 1, n)) for n in range(3))
    other, alone = (("b", 1), ("b", 1, 1)), (("c", 1), ("c", 1, 1))
    held = {one: 3, two: 2, other: 4}
    assert choose_eviction(held, alone) == one, "of the wide network that holds five the fullest"
    assert choose_eviction(held, three) == one, "within its own wide network"
    assert choose_eviction(held, two) is None
    assert choose_eviction({one: 1, two: 1, other: 1}, alone) == one, "they share a wide network"
    assert choose_eviction({one: 1, other: 1}, alone) is None
    assert choose_eviction({one: 1, two: 1, other: 2}, other) is None
    assert largest_holder(held) == one
    assert choose_eviction({}, alone) is None


@pytest.mark.parametrize("seed", range(3))
def test_network_below_its_fair_share_is_admitted(seed: int):
    """Random networks connect and disconnect; an honest connection from another network is never refused."""

    class Connection(asyncio.WriteTransport):
        open = True

        def abort(self) -> None:
            self.open = False

    rng, places, there = random.Random(seed), ConnectionSlots(32, per_network=8), []
    for _ in range(3000):
        if there and rng.random() < 0.3:
            places.leave(*there.pop(rng.randrange(len(there))))
        network = network_of((f"2001:db8:{rng.randrange(3):x}:{rng.randrange(200):x}::1", 1))
        connection = Connection()
        if places.take(network, connection):
            there.append((network, connection))
        there = [(network, connection) for network, connection in there if connection.open]
        assert len(places) == len(there) <= 32
        honest, mine = network_of(("198.51.100.7", 1)), Connection()
        assert places.take(honest, mine)
        places.leave(honest, mine)
        there = [(network, connection) for network, connection in there if connection.open]


def test_a_token_begins_one_transfer():
    serving, here = server(), ("192.0.2.1", 1)
    request = encode(Request(7, token(serving, here, 7, 0.0), ""))
    welcome = decode(serving.receive(here, request, 0.0))
    serving.receive(here, encode(Bye(welcome.session)), 0.1)
    for tenths in range(2, 200):
        assert serving.receive(here, request, tenths / 10) is None
    assert (serving.num_served, serving.num_transfers) == (1, 0)


def test_transfer_starts_per_network_are_rate_limited():
    serving, nonces = server(), iter(range(10_000))

    def begun(host: str, start: float) -> int:
        count = 0
        for n in range(60):
            answer = begin(serving, (host, n), next(nonces), start + n / 10)
            if isinstance(answer, Welcome):
                count += 1
                serving.receive((host, n), encode(Bye(answer.session)), start + n / 10)
            else:
                assert answer.reason == TOO_MANY
        return count

    assert begun("192.0.2.1", 0.0) == MAX_STARTS_FACTOR * LIMITS.per_network
    assert begun("192.0.2.1", 30.0) == 0
    assert begun("192.0.2.2", 30.0) == MAX_STARTS_FACTOR * LIMITS.per_network
    assert begun("192.0.2.1", WINDOW_S + 1) == MAX_STARTS_FACTOR * LIMITS.per_network


@pytest.mark.parametrize("reliable", [False, True])
def test_refusals_per_network_are_rate_limited(reliable, caplog):
    """A client repeats requests for a stream that does not exist, which over QUIC cost one message each."""
    serving, here = server(), ("192.0.2.1", 1)
    caplog.set_level(logging.INFO, "splatwire")

    def answer(nonce: int, name: str, now: float) -> Welcome | Refuse:
        proof = bytes(16) if reliable else token(serving, here, nonce, now, name)
        request = encode(Request(nonce, proof, name))
        return decode(serving.receive(here, request, now, reliable=reliable))

    reasons = [answer(nonce, "other", nonce / 100).reason for nonce in range(200)]
    allowed = MAX_STARTS_FACTOR * LIMITS.per_network
    assert reasons == [UNKNOWN_STREAM] * allowed + [TOO_MANY] * (200 - allowed)
    assert sum("transfer refused" in record.getMessage() for record in caplog.records) == allowed
    assert serving.num_refused == 200
    assert isinstance(answer(1000, "", 3.0), Welcome)
    assert answer(1001, "other", WINDOW_S + 3).reason == UNKNOWN_STREAM


def test_repeated_requests_are_answered_rarely_and_not_after_feedback():
    serving, here = server(), ("192.0.2.1", 1)
    request = encode(Request(7, token(serving, here, 7, 0.0), ""))
    answers = [serving.receive(here, request, n / 1000) for n in range(10_000)]
    responses = [answer for answer in answers if answer]
    assert len(responses) == MAX_WELCOMES
    assert len([answer for answer in answers[:1000] if answer]) <= 1 + 1 / WELCOME_INTERVAL_S
    assert sum(map(len, responses)) < 0.2 * len(request) * len(answers)
    fresh = begin(serving, ("192.0.2.2", 1), 8, 0.0)
    assert isinstance(fresh, Welcome)
    serving.receive(("192.0.2.2", 1), encode(Feedback(fresh.session, 0, 0, 0, 3)), 0.1)
    again = encode(Request(8, token(serving, ("192.0.2.2", 1), 8, 0.0), ""))
    assert [serving.receive(("192.0.2.2", 1), again, 0.2 * n) for n in range(2, 40)] == [None] * 38


def test_client_is_ended_after_its_share_of_bytes():
    serving, here = server(ServerLimits(fixed_rate=1e8)), ("192.0.2.1", 1)
    session, sent, now = begin(serving, here, 1, 0.0).session, 0, 0.0
    while serving.num_transfers and now < 60:
        now += 0.06
        serving.receive(here, encode(Feedback(session, 0, 0, 0, 1000, tuple(range(12)))), now)
        sent += sum(len(data) for _, data in serving.poll(now, max_datagrams=1000))
    assert now < 60
    assert sent < 4.1 * sum(PROGRAM.sizes().values()) + 200_000


def test_memory_of_start_records_is_bounded():
    starts = StartRateLimiter(8)
    for n in range(3 * MAX_NETWORKS):
        if n == 2 * MAX_NETWORKS:
            tracemalloc.start()
        starts.record((n,), n, 0.0)
    assert tracemalloc.get_traced_memory()[0] < 1_000 * MAX_NETWORKS
    tracemalloc.stop()
    assert [starts.has_started((n,), n) for n in (0, 3 * MAX_NETWORKS - 1)] == [False, True]
    assert len(starts._networks) == MAX_NETWORKS


def test_unanswered_opening_expires():
    """A delayed server does not send an outdated opening."""
    serving = server()
    assert isinstance(begin(serving, ("192.0.2.1", 1), 1, 0.0), Welcome)
    assert serving.next_at() is not None
    assert serving.poll(5.0) == []
    assert serving.next_at() is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_three_clients_with_many_requests_leave_slots_for_others(seed: int):
    """Random greetings, replays, feedback and closes from 600 ports of three machines, for two minutes."""
    rng, serving, said = random.Random(seed), server(), list[tuple[Address, bytes]]()
    hosts = ("192.0.2.1", "192.0.2.2", "2001:db8::1")
    asked, answered, sent, begun, now = Counter[str](), Counter[str](), Counter[str](), Counter[str](), 0.0
    sessions: list[tuple[Address, int]] = []
    for _ in range(6_000):
        now += 0.02
        here = (rng.choice(hosts), rng.randrange(200))
        kind, nonce = rng.random(), rng.randrange(1 << 32)
        if kind < 0.3 and said:
            here, data = rng.choice(said[-500:])
        elif kind < 0.6 or not sessions:
            data = encode(Request(nonce, token(serving, here, nonce, now), ""))
            said.append((here, data))
        else:
            here, session = rng.choice(sessions[-50:])
            report = Feedback(session, 0, 0, 0, rng.randrange(9), tuple(rng.sample(range(12), 9)))
            data = encode(Bye(session) if rng.random() < 0.1 else report)
        asked[here[0]] += len(data)
        answer = serving.receive(here, data, now)
        if answer is not None:
            answered[here[0]] += len(answer)
            message = decode(answer)
            if isinstance(message, Welcome) and (here, message.session) not in sessions:
                sessions.append((here, message.session))
                begun[here[0]] += 1
        for address, datagram in serving.poll(now):
            sent[address[0]] += len(datagram)
        mine = Counter(address[0] for address, _ in serving._transfers)
        assert max(mine.values(), default=0) <= LIMITS.per_network
    one_pass = sum(PROGRAM.sizes().values())
    for host in hosts:
        assert begun[host] <= 3 * MAX_STARTS_FACTOR * LIMITS.per_network
        assert answered[host] < asked[host]
        assert sent[host] <= begun[host] * (LIMITS.max_sent_ratio * one_pass + 102_000)
    assert isinstance(begin(serving, ("198.51.100.1", 1), 1, now), Welcome)


def test_starts_are_forgotten_after_the_window() -> None:
    """Each of many networks would otherwise keep its starts for ever."""
    starts = StartRateLimiter(3)
    for number in range(100):
        starts.record((number,), number, number / 100)
    assert len(starts) == 100
    starts.record((5,), 4711, WINDOW_S + 0.505)
    assert len(starts) == 100 - 51 + 1
    assert not starts.has_started((4,), 4)
    assert starts.has_started((99,), 99)
    starts.record((5,), 4711, 3 * WINDOW_S)
    assert len(starts) == 1
    assert starts.may_start((5,), 4 * WINDOW_S)
    assert len(starts) == 0


def test_a_nonce_that_starts_again_counts_each_time() -> None:
    starts = StartRateLimiter(3)
    for now in range(3):
        assert starts.may_start(("client",), float(now))
        starts.record(("client",), 7, float(now))
    assert not starts.may_start(("client",), 3.0)
    starts.record(("client",), 8, 3.0)
    assert starts.has_started(("client",), 7)
    for now in range(4, 6):
        starts.record(("client",), 8, float(now))
    assert not starts.has_started(("client",), 7)
    assert len(starts) == 3


@pytest.mark.parametrize(
    "limits",
    [{"sessions": -1}, {"per_network": 0}, *({name: 0.0} for name in (
        "silence_s", "rate", "start_rate", "fixed_rate", "total_rate", "max_sent_ratio"
    )), {"rate": -1.0}],
)  # fmt: skip
def test_limits_with_which_no_transfer_is_possible_are_refused(limits: dict[str, Any]) -> None:
    (name,) = limits
    with pytest.raises(InvalidValueError, match=name):
        ServerLimits(**limits)
    assert ServerLimits(sessions=0).sessions == 0


@pytest.mark.parametrize("seconds", [0.0, -1.0])
def test_a_receiver_without_patience_is_refused(seconds: float) -> None:
    with pytest.raises(InvalidValueError, match="silence_s is above 0 seconds"):
        ReceiverOptions(silence_s=seconds)
