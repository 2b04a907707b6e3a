"""What is looked at comes first, over any way that has datagrams; views that cannot be are nobody's."""

import os
import random
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.errors import BitstreamError
from splatwire.levels import Look, encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization
from splatwire.packets.tiles import read_tiles
from splatwire.packets.view import cut_of
from splatwire.transport import PacketArrived, Receiver, ReceiverOptions, Server, make_program, program
from splatwire.transport.frames import BY_SEQUENCE, VIEWS, Feedback, Request, View
from splatwire.transport.order import LOOK_S, Order, Turns
from splatwire.transport.transfer import ServerLimits, ServerTransfer
from splatwire.transport.wire import DATA, SIDE, decode, encode
from transport.network import SECRET, Link, bernoulli, transfer

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "600"))
STREAM = encode_levels(
    SplatScene(some_splats(3000)), Packetization(block_size=60, lanes=1, grouping="hashed", packet_bytes=500)
)
with patch.object(program, "OPENING_BYTES", 6000):
    PROGRAM = make_program(STREAM)
TILES = PROGRAM.tiles


def looking(at: int, distance: float = 0.5, focal: float = 200.0) -> Look:
    """From near a tile."""
    matrix = np.eye(4)
    matrix[:3, 3] = -(TILES.low[at] + TILES.high[at]) / 2 + [0, 0, distance]
    return Look(matrix, focal, 320, 240)


def view(look: Look, number: int = 1, session: int = 0, budget: int = 10**6) -> View:
    rows = tuple(look.viewmat[:3].ravel().tolist())
    return View(session, number, budget, look.width, look.height, look.focal, rows)


FAR = looking(57, 50.0)
SHARP = looking(57, focal=1e5)
"""For which no tile is too coarse."""


def seen_tiles(result) -> list[int]:
    """Tiles in the order in which they began to come."""
    blocks = [event.packet.id.block for event in result.events if isinstance(event, PacketArrived)]
    return list(dict.fromkeys(blocks))


def test_what_is_looked_at_comes_first_and_nothing_that_is_not():
    opening = int(np.searchsorted(TILES.first_packets, PROGRAM.opening_packets))
    for look in (looking(20), SHARP, FAR):
        result = transfer(PROGRAM, options=ReceiverOptions(look=look))
        there = np.arange(TILES.num_tiles) < opening
        wanted = cut_of(TILES, there, look).wanted
        assert seen_tiles(result) == [*range(opening), *wanted]
        assert result.receiver.finished.ok
        assert result.receiver.finished.reason == ("complete" if look is SHARP else "seen")


@pytest.mark.parametrize("seed", range(3))
def test_lost_packets_of_a_view_come_again(seed):
    rng = random.Random(seed)
    lossy = {"down": Link(bernoulli(0.2, rng)), "up": Link(bernoulli(0.2, rng))}
    result = transfer(PROGRAM, **lossy, options=ReceiverOptions(look=FAR))
    assert result.receiver.finished.reason == "seen"
    came = np.bincount([packet.id.block for packet in result.receiver.stream().packets], minlength=TILES.num_tiles)
    wanted = cut_of(TILES, np.zeros(TILES.num_tiles, bool), FAR).wanted
    assert (came[list(wanted)] == TILES.packets[list(wanted)]).all()
    assert came.sum() < len(STREAM.packets) / 2


def test_without_a_view_everything_comes_from_coarse_to_fine():
    result = transfer(PROGRAM)
    assert result.receiver.finished.reason == "complete"
    assert seen_tiles(result) == list(range(TILES.num_tiles))


def test_a_view_that_moves_goes_on_where_the_last_one_ended():
    """And costs little while it stands still."""
    options, sent = ReceiverOptions(look=FAR, stays=True), []
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    receiver = Receiver(5, 0.0, options, reliable=True)
    for step in range(2000):
        now = step / 100
        if step == 1000:
            receiver.look(SHARP)
        waiting = receiver.poll(now)[0]
        while waiting:
            answer = server.receive("client", waiting.pop(), now, reliable=True)
            waiting += receiver.receive(answer, now)[0] if answer else []
        for _, data in server.poll(now):
            sent.append(now)
            receiver.receive(data, now)
        assert receiver.finished is None or step > 1000
    assert receiver.finished.reason == "complete"
    assert 2 <= sum(5 < at < 10 for at in sent) <= 8


def test_another_server_is_told_no_view():
    older = replace(PROGRAM, tiers=PROGRAM.tiers[:-1], tiles=None)
    assert transfer(older, options=ReceiverOptions(look=FAR)).receiver.finished.reason == "complete"
    assert PROGRAM.tiers[-1] == VIEWS


def a_transfer() -> tuple[Server, int]:
    """One that goes on."""
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    welcome = decode(server.receive("client", encode(Request(1, bytes(16), "")), 0.0, reliable=True))
    return server, welcome.session


def test_a_flood_of_views_is_one_view_ten_times_a_second():
    server, session = a_transfer()
    with patch.object(Order, "look", autospec=True, side_effect=Order.look) as looked:
        for n in range(1000):
            server.receive("client", encode(view(FAR, n, session)), n / 1000)
            server.poll(n / 1000)
        server.receive("client", encode(view(looking(3), 5, session)), 1.0)  # an old one, late
        assert 8 <= looked.call_count <= 11


def test_all_views_together_have_their_turns():
    turns = Turns()
    times = [turns.take(0.0, None, 1000) for _ in range(100)]
    assert times == sorted(times)
    assert times[-1] >= 99 * LOOK_S


def test_views_are_what_they_were():
    frame = view(FAR, 7, 9)
    assert np.allclose(decode(encode(frame)).viewmat, frame.viewmat, atol=1e-6 * 60)
    assert decode(encode(frame))[:5] == frame[:5]


@pytest.mark.parametrize("field", ["focal", "viewmat", "width", "budget"])
def test_views_from_nowhere_are_refused(field):
    good = view(FAR)
    numbers: dict[str, Sequence[object]] = {
        "focal": [0.0, -1.0, float("nan"), float("inf"), 1e7], "width": [0], "budget": [0],
    }  # fmt: skip
    rows = [tuple(value if n == place else x for n, x in enumerate(good.viewmat))
            for place in range(12) for value in (float("nan"), float("inf"), -1e30)]  # fmt: skip
    for value in numbers.get(field) or [*rows, (0.0,) * 12, (2.0, 0, 0, 0, 0, 2.0, 0, 0, 0, 0, 2.0, 0)]:
        with pytest.raises(BitstreamError, match="nowhere"):
            decode(encode(good._replace(**{field: value})))


def test_hostile_views_and_reports_do_no_harm():
    rng, (server, session) = random.Random(3), a_transfer()
    sent = 0
    for n in range(CASES):
        data = bytearray(encode(view(looking(rng.randrange(58), 10.0 ** rng.uniform(-30, 10)), n, session)))
        for _ in range(rng.randrange(4)):
            struct.pack_into("<f", data, rng.randrange(17, 66), rng.choice([1e38, -1e-38, 0.0, 3.0, float("nan")]))
        body = bytes(data[:-4])
        server.receive("client", body + struct.pack("<I", zlib.crc32(body)), n / 100)
        lost = tuple(rng.randrange(1 << 32) | rng.choice([0, BY_SEQUENCE]) for _ in range(20))
        report = Feedback(session, rng.randrange(1 << 12), rng.randrange(1 << 12), n * 10_000, 0, lost)
        server.receive("client", encode(report), n / 100)
        sent += sum(len(data) for _, data in server.poll(n / 100))
    assert sent <= ServerLimits().passes * sum(PROGRAM.sizes().values()) + 200_000


def test_a_number_is_answered_once():
    transfer = ServerTransfer(PROGRAM, 1, ServerLimits(), 0.0, reliable_head=True)
    transfer.welcome()
    times = [n / 200 for n in range(200)]
    places = [decode(data).place for data in map(transfer.poll, times[:100]) if data and data[0] & 15 == DATA]
    for now in times[100:]:
        transfer.feedback(Feedback(1, 0, 0, 0, 0, (BY_SEQUENCE + 3,)), now)
        data = transfer.poll(now)
        places += [decode(data).place] if data and data[0] & 15 == DATA else []
    assert places.count(3) == 2


@pytest.mark.parametrize("opening_bytes", [1, 2000, 6000, 10**6, 10**9])
@pytest.mark.parametrize("reliable", [True, False])
@pytest.mark.parametrize("late", [0, 1, 30, 10**6])
def test_the_opening_is_counted_in_the_schedule_that_is_sent(opening_bytes, reliable, late):
    with patch.object(program, "OPENING_BYTES", opening_bytes):
        served = make_program(STREAM)
    order, left = Order(served, reliable), []
    while order and len(left) < late:
        left.append(order.pop())
    order.look(SHARP, 10**9, 0.0)
    while order:
        left.append(order.pop())
        if order.head_left:
            assert sum(item[0] == SIDE for item in left) == sum(
                item[0] == SIDE for item in (served.reliable_schedule if reliable else served.send_schedule).items
            )
    packets = [item[2] for item in left if item[0] == DATA]
    assert sorted(packets) == list(range(served.carried, len(served.packets)))  # each one, once
    assert all(item[2] < served.opening_packets for item in left[: late and 1] if item[0] == DATA)


def test_an_error_while_one_client_is_served_ends_this_client_alone_and_is_one_line(caplog):
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    sessions, gone = {}, []
    server._on_failure = gone.append
    for nonce, address in enumerate(("honest", "unlucky")):
        answer = server.receive(address, encode(Request(nonce, bytes(16), "")), 0.0, reliable=True)
        sessions[address] = decode(answer).session
    unlucky = server._transfers["unlucky", 1]._order
    counts, pops = {"honest": 0, "unlucky": 0}, []

    def pop(self):
        if self is unlucky and pops.append(0) is None and len(pops) > 5:
            raise IndexError("tuple index out of\nrange \x1b[2J")
        return taken(self)

    taken = Order.pop
    with patch.object(Order, "pop", pop):
        for step in range(1000):
            for address, _ in server.poll(step / 1000):
                counts[address] += 1
            if step % 100 == 0:
                for address, session in sessions.items():
                    server.receive(address, encode(Feedback(session, 0, 0, 0, 0, ())), step / 1000)
    assert counts["unlucky"] == 5
    assert counts["honest"] > 20
    assert gone == ["unlucky"]
    assert (server.num_failed, server.num_transfers) == (1, 1)
    (record,) = caplog.records
    assert "IndexError" in record.getMessage()
    assert record.getMessage().isprintable()
    assert record.exc_info is None


def test_hostile_indexes_are_refused_or_served():
    """What a server reads of a file that somebody made."""
    rng, side_info = random.Random(6), STREAM.side_info
    for _ in range(CASES):
        changed = bytearray(side_info)
        for _ in range(rng.randrange(1, 5)):
            changed[rng.randrange(len(changed))] = rng.randrange(256)
        cut = rng.randrange(len(changed)) if rng.random() < 0.1 else None
        try:
            tiles = read_tiles(STREAM.manifest, bytes(changed[:cut]))
        except BitstreamError:
            continue
        with np.errstate(all="raise"):
            wanted = cut_of(tiles, np.zeros(tiles.num_tiles, bool), looking(20)).wanted
        assert len(set(wanted)) == len(wanted) <= tiles.num_tiles
        order = Order(replace(PROGRAM, tiles=tiles), True)
        order.look(looking(20), 10**6, 0.0)
        left = []
        while order:
            left.append(order.pop())
        assert len(left) <= 2 * (len(PROGRAM.schedule) + len(PROGRAM.packets))
        assert all(item[2] < len(PROGRAM.packets) for item in left if item[0] == DATA)
