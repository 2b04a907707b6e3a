"""Hostile datagrams cause no crash, no accepted forgery and no unbounded memory."""

import random
import tracemalloc

import pytest

from splatwire.bitstream import PacketId, make_packet
from splatwire.transport import Event, PacketArrived, Receiver, Server, ServerLimits, make_served_stream
from splatwire.transport.protocol.messages import (
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Hello,
    InitSymbol,
    Parity,
    ParityRange,
    Refuse,
    Request,
    Welcome,
)
from splatwire.transport.protocol.wire import VERSION, decode, encode
from transport.network import SECRET, datagram_stream

pytestmark = pytest.mark.slow

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
STREAM = datagram_stream(num_anchors=4000, side_bytes=20_000)
PROGRAM = make_served_stream(STREAM)
HOSTILE = 20_000
"""Number of datagrams into each of the two ends."""
TRACED = 4000
"""Number of last datagrams during which memory must not grow."""


def handshake(server: Server, receiver: Receiver) -> list[bytes]:
    """Runs the handshake until the receiver is accepted; returns all frames."""
    said: list[bytes] = []
    out, _ = receiver.poll(0.0)
    while out:
        said += out
        answers = [server.receive("client", data, 0.0) for data in out]
        said += [a for a in answers if a]
        out = [reply for answer in answers if answer for reply in receiver.receive(answer, 0.0)[0]]
    assert receiver.welcome is not None
    return said


def finish(server: Server, receiver: Receiver) -> list[Event]:
    """Runs both ends undisturbed for some seconds."""
    now, events = 0.0, []
    while receiver.finished is None and now < 3.0:
        now += 0.02
        for _, data in server.poll(now, max_datagrams=1000):
            out, new_events = receiver.receive(data, now)
            events += new_events
            for reply in out:
                server.receive("client", reply, now)
        out, new_events = receiver.poll(now)
        events += new_events
        for data in out:
            server.receive("client", data, now)
    return events


def hostile(rng: random.Random, seen: list[bytes], session: int, stream_id: int) -> bytes:
    """One hostile datagram of a random kind."""
    big = [0, 1, 255, 256, 65_535, 1 << 20, (1 << 31) - 1, (1 << 32) - 1]
    number = lambda: rng.choice(big)  # noqa: E731
    match rng.randrange(8):
        case 0:
            return rng.randbytes(rng.randrange(1400))
        case 1:
            return bytes([VERSION << 4 | rng.randrange(16)]) + rng.randbytes(rng.randrange(1250))
        case 2 | 3:  # mutated: bits, cuts, additions
            data = bytearray(rng.choice(seen))
            for _ in range(rng.randrange(1, 4)):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            return bytes(data[: rng.randrange(len(data))] if rng.random() < 0.3 else data)
        case 4:  # replayed
            return rng.choice(seen)
        case 5:  # well-formed, of other transfers
            other = rng.getrandbits(32)
            return encode(
                rng.choice([Bye(other), End(other, 1), InitSymbol(other, 1, 0, 0, bytes(256)), Data(other, 1, 0, b"x")])
            )
        case 6:  # well-formed, impossible numbers
            mine = rng.choice([session, number()])
            return encode(
                rng.choice(
                    [
                        InitSymbol(mine, number(), number() & 0xFFFF, number(), rng.randbytes(rng.randrange(1, 1150))),
                        Parity(mine, number(), number() & 0xFFFF, number(), rng.randbytes(rng.randrange(1, 1153))),
                        Feedback(mine, number(), number(), number(), number(), tuple(number() for _ in range(250))),
                        Welcome(number(), mine, number(), number(), bytes(32), 65535, number(), 65535,
                                number(), (ParityRange(number(), 65535, 65535),) * 8, rng.randbytes(number() & 1023)),
                        Refuse(number(), rng.randrange(256)),
                        Challenge(number(), rng.randbytes(16)),
                        Request(number(), rng.randbytes(16), "scene", rng.choice(["", "ab.cd.ef"])),
                        Hello(number(), rng.choice(["", "scene", "x" * 64])),
                    ]
                )
            )  # fmt: skip
        case _:  # packets of another stream or outside of this one's plan, with valid checksums
            packet_id, place = PacketId(number() & 0xFFFFFF, number() & 0x3FFF), rng.randrange(200)
            packet = make_packet(packet_id, 1 + number() % 65_535, b"evil", rng.choice([stream_id, 7]))
            return encode(Data(session, number(), place, packet.data))


def test_receiver_survives_hostile_datagrams():
    rng = random.Random(1)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes, limits=ServerLimits(fixed_rate=1e9))
    receiver = Receiver(rng.getrandbits(64), 0.0)
    seen = handshake(server, receiver)
    session, now, events = receiver.welcome.session, 0.0, []
    good = [data for _ in range(40) for _, data in server.poll(1.0)]
    seen += good[: len(good) // 2]
    for data in good[: len(good) // 2]:
        events += receiver.receive(data, now)[1]
    for n in range(HOSTILE):
        if n == HOSTILE - TRACED:
            tracemalloc.start()
        events += receiver.receive(hostile(rng, seen, session, STREAM.manifest.stream_id), now)[1]
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < PROGRAM.init_segment_bytes
    assert receiver.finished is None
    events += finish(server, receiver)
    stream = receiver.stream()
    assert stream.side_info == STREAM.side_info
    true = {packet.id: packet for packet in STREAM.packets}
    wrong = [packet for packet in stream.packets if true.get(packet.id) != packet]
    forged = [packet for packet in wrong if packet.payload == b"evil"]
    assert wrong == forged, "a packet that nobody made"
    assert {event.packet.id for event in events if isinstance(event, PacketArrived)} == {p.id for p in stream.packets}


def test_off_path_attacker_cannot_inject_packets():
    """An off-path attacker guesses neither session nor stream: every anchor is correct."""
    rng = random.Random(2)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes, limits=ServerLimits(fixed_rate=1e9))
    receiver = Receiver(rng.getrandbits(64), 0.0)
    seen = handshake(server, receiver)
    good = [data for _ in range(40) for _, data in server.poll(1.0)]
    assert len(good) > 100
    for n, data in enumerate(good):
        for _ in range(20):
            receiver.receive(hostile(rng, seen + good[: n + 1], 1, 7), 0.0)
        receiver.receive(data, 0.0)
    finish(server, receiver)
    assert receiver.finished.reason == "complete"
    assert receiver.stream() == STREAM


def test_server_survives_hostile_datagrams():
    rng = random.Random(3)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes)
    receiver = Receiver(rng.getrandbits(64), 0.0)
    seen = handshake(server, receiver)
    session, answered = receiver.welcome.session, 0
    for n in range(HOSTILE):
        if n == HOSTILE - TRACED:
            tracemalloc.start()
        data, address = hostile(rng, seen, session, 7), rng.choice(["client", "other", n])
        if data[:1] == b"\x19" and address == "client":
            continue  # a Bye from the client's own address may end its transfer
        answer = server.receive(address, data, 0.0)
        if answer is not None:
            assert len(answer) <= len(data) or address == "client"
            assert address == "client" or decode(answer).__class__ in (Challenge, Refuse)
            answered += len(answer)
    assert tracemalloc.get_traced_memory()[0] < 500_000
    tracemalloc.stop()
    assert server.num_transfers == 1
    finish(server, receiver)
    assert receiver.finished.reason == "complete"
    assert receiver.stream() == STREAM


def test_unvalidated_address_gets_one_small_answer():
    server = Server({"scene": PROGRAM}, secret=SECRET, random=random.Random(0).randbytes)
    hello = encode(Hello(5, ""))
    answer = server.receive("victim", hello, 0.0)
    assert len(answer) * 20 < len(hello)
    token = decode(answer).token
    assert server.receive("other", encode(Request(5, token, "")), 0.0) is None
    assert server.receive("victim", encode(Request(6, token, "")), 0.0) is None
    assert server.receive("victim", encode(Request(5, token, "")), 25.0) is None
    assert server.num_transfers == 0
    assert server.poll(1.0) == []
    assert decode(server.receive("victim", encode(Request(5, token, "")), 9.0)).num_packets == len(PROGRAM.packets)
    assert server.poll(9.0) == [], "nothing is sent before the client reports"


def test_silent_client_expires_and_bytes_per_client_are_limited():
    rng = random.Random(4)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes, limits=ServerLimits(fixed_rate=1e9))
    receiver = Receiver(rng.getrandbits(64), 0.0)
    handshake(server, receiver)
    session, sent, now = receiver.welcome.session, 0, 0.0
    for _ in range(2000):
        now += 0.06
        nacks = tuple(range(len(PROGRAM.packets)))[:250]
        server.receive("client", encode(Feedback(session, 0, 0, 0, 1000, nacks)), now)
        sent += sum(len(data) for _, data in server.poll(now, max_datagrams=1000))
    assert sent < 4.1 * sum(PROGRAM.sizes().values()) + 200_000
    server.poll(now + 6.0)
    assert server.num_transfers == 0


def test_false_acknowledgements_are_ignored():
    rng = random.Random(5)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes)
    receiver = Receiver(rng.getrandbits(64), 0.0)
    handshake(server, receiver)
    session = receiver.welcome.session
    before = next(iter(server._transfers.values())).control.rate
    for n in range(1, 50):
        server.receive("client", encode(Feedback(session, 10_000 * n, 10_000 * n, n, 0)), 0.01 * n)
    assert next(iter(server._transfers.values())).control.rate == before


def test_requests_in_a_flood_of_reports_are_ignored():
    """They would take much more time than the reports themselves."""
    rng = random.Random(7)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes)
    receiver = Receiver(rng.getrandbits(64), 0.0)
    handshake(server, receiver)
    transfer, session = next(iter(server._transfers.values())), receiver.welcome.session

    def queued_after(now: float, index: int) -> int:
        server.receive("client", encode(Feedback(session, 0, 0, 0, 0, (index,))), now)
        return len(transfer._retransmissions)

    assert queued_after(0.0, 0) == 1
    for _ in range(1000):
        server.receive("client", encode(Feedback(session, 0, 0, 0, 0)), 0.01)
    assert queued_after(0.01, 1) == 1
    assert queued_after(0.05, 2) == 2
    finish(server, receiver)
    assert receiver.stream() == STREAM


def test_poisoned_side_information_is_discarded_and_requested_again():
    rng = random.Random(6)
    server = Server({"scene": PROGRAM}, secret=SECRET, random=rng.randbytes, limits=ServerLimits(fixed_rate=1e9))
    receiver = Receiver(rng.getrandbits(64), 0.0)
    handshake(server, receiver)
    session, size = receiver.welcome.session, PROGRAM.symbol_bytes
    receiver.receive(encode(InitSymbol(session, 1, 0, 3, bytes(size))), 0.0)
    finish(server, receiver)
    assert receiver.finished.reason == "complete"
    assert receiver.stream() == STREAM
