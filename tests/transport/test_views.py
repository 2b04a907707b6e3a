"""Visible tiles are sent first over any transport with datagrams; invalid views are ignored."""

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
from splatwire.bitstream import Packetization, SceneStream
from splatwire.bitstream.sections import with_section
from splatwire.bitstream.tile_selection import cut_of
from splatwire.bitstream.tiles import read_tiles
from splatwire.errors import BitstreamError
from splatwire.lod import Viewpoint, encode_levels
from splatwire.transport import PacketArrived, Receiver, ReceiverOptions, Server, make_served_stream
from splatwire.transport.protocol import served_stream
from splatwire.transport.protocol.messages import Feedback, Request, ViewUpdate
from splatwire.transport.protocol.send_queue import VIEW_UPDATE_COST_S, SendQueue, ViewUpdateBudget
from splatwire.transport.protocol.transfer import ServerLimits, ServerTransfer
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, decode, encode
from splatwire.types import SplatScene
from transport.network import SECRET, Link, bernoulli, transfer

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "600"))
STREAM = encode_levels(
    SplatScene(some_splats(3000)), Packetization(block_size=60, lanes=1, grouping="hashed", packet_bytes=500)
)
with patch.object(served_stream, "OPENING_BYTES", 6000):
    PROGRAM = make_served_stream(STREAM)
TILES = PROGRAM.tiles


def looking(at: int, distance: float = 0.5, focal: float = 200.0) -> Viewpoint:
    """View from near a tile."""
    matrix = np.eye(4)
    matrix[:3, 3] = -(TILES.low[at] + TILES.high[at]) / 2 + [0, 0, distance]
    return Viewpoint(matrix, focal, 320, 240)


def view(viewpoint: Viewpoint, number: int = 1, session: int = 0, budget: int = 10**6) -> ViewUpdate:
    rows = tuple(viewpoint.viewmat[:3].ravel().tolist())
    return ViewUpdate(session, number, budget, viewpoint.width, viewpoint.height, viewpoint.focal, rows)


FAR = looking(57, 50.0)
SHARP = looking(57, focal=1e5)
"""View without any too coarse tile."""


def seen_tiles(result) -> list[int]:
    """Tiles in the order of their first packets."""
    blocks = [event.packet.id.block for event in result.events if isinstance(event, PacketArrived)]
    return list(dict.fromkeys(blocks))


def test_visible_tiles_are_sent_first_and_invisible_ones_never():
    opening = int(np.searchsorted(TILES.first_packets, PROGRAM.opening_packets))
    for viewpoint in (looking(20), SHARP, FAR):
        result = transfer(PROGRAM, options=ReceiverOptions(viewpoint=viewpoint))
        there = np.arange(TILES.num_tiles) < opening
        wanted = cut_of(TILES, there, viewpoint).wanted
        assert seen_tiles(result) == [*range(opening), *wanted]
        assert result.receiver.finished.ok
        assert result.receiver.finished.reason == ("complete" if viewpoint is SHARP else "seen")


def somewhere(stream: SceneStream, origin: tuple[float, float, float]) -> SceneStream:
    """The same scene elsewhere in the world."""
    return with_section(stream, "origin", struct.pack("<3d", *origin))


UTM, NEAR, ZERO = (442_000.0, 5_443_000.0, 120.0), (120.0, -80.0, 10.0), (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("stream_at", "camera_at"), [(UTM, ZERO), (UTM, UTM), (UTM, NEAR), (NEAR, ZERO), (ZERO, NEAR)])
@pytest.mark.parametrize("delay", [0.02, 0.4])
def test_a_view_is_taken_relative_to_the_origin_of_the_stream(stream_at, camera_at, delay):
    """The camera keeps its place in front of the scene for any origin of its matrix and of the scene."""
    there = looking(20)
    world = replace(there, origin=stream_at).relative_to(camera_at)
    with patch.object(served_stream, "OPENING_BYTES", 6000):
        served = make_served_stream(somewhere(STREAM, stream_at))
    links = {"down": Link(delay_s=delay), "up": Link(delay_s=delay)}
    result = transfer(served, **links, options=ReceiverOptions(viewpoint=world))
    opening = int(np.searchsorted(TILES.first_packets, PROGRAM.opening_packets))
    wanted = cut_of(TILES, np.arange(TILES.num_tiles) < opening, there).wanted
    assert result.receiver.finished.reason == "seen"
    assert set(wanted) <= set(seen_tiles(result))
    assert len(seen_tiles(result)) < opening + len(wanted) + (TILES.num_tiles - opening - len(wanted)) / 4
    came = np.bincount([packet.id.block for packet in result.receiver.stream().packets], minlength=TILES.num_tiles)
    assert (came[list(wanted)] == TILES.packets[list(wanted)]).all()


@pytest.mark.parametrize("seed", range(3))
def test_lost_packets_of_a_view_are_retransmitted(seed):
    rng = random.Random(seed)
    lossy = {"down": Link(bernoulli(0.2, rng)), "up": Link(bernoulli(0.2, rng))}
    result = transfer(PROGRAM, **lossy, options=ReceiverOptions(viewpoint=FAR))
    assert result.receiver.finished.reason == "seen"
    came = np.bincount([packet.id.block for packet in result.receiver.stream().packets], minlength=TILES.num_tiles)
    wanted = cut_of(TILES, np.zeros(TILES.num_tiles, bool), FAR).wanted
    assert (came[list(wanted)] == TILES.packets[list(wanted)]).all()
    assert came.sum() < len(STREAM.packets) / 2


def test_transfer_without_a_view_is_coarse_to_fine():
    result = transfer(PROGRAM)
    assert result.receiver.finished.reason == "complete"
    assert seen_tiles(result) == list(range(TILES.num_tiles))


def test_moved_view_continues_without_resending():
    """A resting view has a small rate."""
    options, sent = ReceiverOptions(viewpoint=FAR, keep_open=True), []
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    receiver = Receiver(5, 0.0, options, reliable=True)
    for step in range(2000):
        now = step / 100
        if step == 1000:
            receiver.set_viewpoint(SHARP)
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


def test_server_without_views_gets_no_view_update():
    older = replace(PROGRAM, tiles=None)
    assert transfer(older, options=ReceiverOptions(viewpoint=FAR)).receiver.finished.reason == "complete"
    assert PROGRAM.view_dependent


def server_with_transfer() -> tuple[Server, int]:
    """A view that moves on."""
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    welcome = decode(server.receive("client", encode(Request(1, bytes(16), "")), 0.0, reliable=True))
    return server, welcome.session


def test_view_updates_are_limited_to_ten_per_second():
    server, session = server_with_transfer()
    with patch.object(SendQueue, "set_viewpoint", autospec=True, side_effect=SendQueue.set_viewpoint) as looked:
        for n in range(1000):
            server.receive("client", encode(view(FAR, n, session)), n / 1000)
            server.poll(n / 1000)
        server.receive("client", encode(view(looking(3), 5, session)), 1.0)  # an old one, late
        assert 8 <= looked.call_count <= 11


def test_view_updates_of_all_clients_are_scheduled_in_turns():
    turns = ViewUpdateBudget()
    times = [turns.take(0.0, None, 1000) for _ in range(100)]
    assert times == sorted(times)
    assert times[-1] >= 99 * VIEW_UPDATE_COST_S


def test_view_update_round_trips():
    message = view(FAR, 7, 9)
    assert np.allclose(decode(encode(message)).viewmat, message.viewmat, atol=1e-6 * 60)
    assert decode(encode(message))[:5] == message[:5]


@pytest.mark.parametrize("field", ["focal", "viewmat", "width", "budget"])
def test_non_finite_views_are_refused(field):
    good = view(FAR)
    numbers: dict[str, Sequence[object]] = {
        "focal": [0.0, -1.0, float("nan"), float("inf"), 1e7], "width": [0], "budget": [0],
    }  # fmt: skip
    rows = [tuple(value if n == place else x for n, x in enumerate(good.viewmat))
            for place in range(12) for value in (float("nan"), float("inf"), -1e30)]  # fmt: skip
    for value in numbers.get(field) or [*rows, (0.0,) * 12, (2.0, 0, 0, 0, 0, 2.0, 0, 0, 0, 0, 2.0, 0)]:
        with pytest.raises(BitstreamError, match="invalid camera"):
            decode(encode(good._replace(**{field: value})))


def test_hostile_views_and_feedback_are_survived():
    rng, (server, session) = random.Random(3), server_with_transfer()
    sent = 0
    for n in range(CASES):
        data = bytearray(encode(view(looking(rng.randrange(58), 10.0 ** rng.uniform(-30, 10)), n, session)))
        for _ in range(rng.randrange(4)):
            struct.pack_into("<f", data, rng.randrange(17, 66), rng.choice([1e38, -1e-38, 0.0, 3.0, float("nan")]))
        body = bytes(data[:-4])
        server.receive("client", body + struct.pack("<I", zlib.crc32(body)), n / 100)
        lost = [tuple(rng.randrange(1 << 32) >> rng.choice([0, 20]) for _ in range(10)) for _ in range(2)]
        report = Feedback(session, rng.randrange(1 << 12), rng.randrange(1 << 12), n * 10_000, 0, *lost)
        server.receive("client", encode(report), n / 100)
        sent += sum(len(data) for _, data in server.poll(n / 100))
    assert sent <= ServerLimits().max_sent_ratio * sum(PROGRAM.sizes().values()) + 200_000


def test_each_nack_number_is_answered_once():
    transfer = ServerTransfer(PROGRAM, 1, ServerLimits(), 0.0, reliable_init_segment=True)
    transfer.welcome()
    times = [n / 200 for n in range(200)]
    places = [decode(data).packet_index for data in map(transfer.poll, times[:100]) if data and data[0] & 15 == DATA]
    for now in times[100:]:
        transfer.on_feedback(Feedback(1, 0, 0, 0, 0, (), (3,)), now)
        data = transfer.poll(now)
        places += [decode(data).packet_index] if data and data[0] & 15 == DATA else []
    assert places.count(3) == 2


@pytest.mark.parametrize("opening_bytes", [1, 2000, 6000, 10**6, 10**9])
@pytest.mark.parametrize("reliable", [True, False])
@pytest.mark.parametrize("late", [0, 1, 30, 10**6])
def test_opening_is_counted_in_the_sent_schedule(opening_bytes, reliable, late):
    with patch.object(served_stream, "OPENING_BYTES", opening_bytes):
        served = make_served_stream(STREAM)
    order, left = SendQueue(served, reliable), []
    while order and len(left) < late:
        left.append(order.pop())
    order.set_viewpoint(SHARP, 10**9, 0.0)
    while order:
        left.append(order.pop())
        if order.popped_last_init_symbol:
            assert sum(item[0] == INIT_SYMBOL for item in left) == sum(
                item[0] == INIT_SYMBOL
                for item in (served.reliable_schedule if reliable else served.send_schedule).datagrams
            )
    packets = [item[2] for item in left if item[0] == DATA]
    assert sorted(packets) == list(range(served.num_bundled, len(served.packets)))  # each one, once
    assert all(item[2] < served.opening_packets for item in left[: late and 1] if item[0] == DATA)


def test_error_of_one_client_ends_that_client_only(caplog):
    server = Server({"": PROGRAM}, secret=SECRET, random=random.Random(1).randbytes)
    sessions, gone = {}, []
    server._on_failure = gone.append
    for nonce, address in enumerate(("honest", "unlucky")):
        answer = server.receive(address, encode(Request(nonce, bytes(16), "")), 0.0, reliable=True)
        sessions[address] = decode(answer).session
    unlucky = server._transfers["unlucky", 1]._queue
    counts, pops = {"honest": 0, "unlucky": 0}, []

    def pop(self):
        if self is unlucky and pops.append(0) is None and len(pops) > 5:
            raise IndexError("tuple index out of\nrange \x1b[2J")
        return taken(self)

    taken = SendQueue.pop
    with patch.object(SendQueue, "pop", pop):
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


@pytest.mark.slow
def test_hostile_indexes_are_refused_or_served():
    """A server reads an untrusted index from a file."""
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
        order = SendQueue(replace(PROGRAM, tiles=tiles), True)
        order.set_viewpoint(looking(20), 10**6, 0.0)
        left = []
        while order:
            left.append(order.pop())
        assert len(left) <= 2 * (len(PROGRAM.schedule) + len(PROGRAM.packets))
        assert all(item[2] < len(PROGRAM.packets) for item in left if item[0] == DATA)
