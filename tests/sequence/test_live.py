"""Live clips decode to the same frames as recorded clips."""

import dataclasses
import gc
import itertools
import random
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import splatwire
from live_path import FRAME_RATE, STREAM_ID, LivePath
from moving_sequences import darkened, moving_frames
from oversized import of_tracks
from splatwire.bitstream import packet_from_bytes, read_stream
from splatwire.bitstream.limits import TRACKS
from splatwire.bitstream.sections import split_sections
from splatwire.bitstream.tiers import TierCounts
from splatwire.codec import decode_stream
from splatwire.codec.initial_view import EXTENT_SECTION
from splatwire.codec.memory import VARIABLE
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.sequence import SequenceEncoder, SequenceOptions, decode_frames
from splatwire.sequence.importance import stream_importance
from splatwire.sequence.live_decoder import LiveDecoder
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.transport import Receiver, ServerLimits
from splatwire.transport.protocol.layout import parity_groups
from splatwire.transport.protocol.live_packager import PROTECTION, LivePackager, LiveSnapshot
from splatwire.transport.protocol.messages import ParityRange, Request, Welcome
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY, decode, encode, message_kind

pytestmark = pytest.mark.slow

GROUP = 5


@pytest.fixture(scope="module")
def frames():
    return moving_frames(1500, 33)


def same(frame, other) -> bool:
    """Returns True if two frames show the same Gaussians."""
    ours, theirs = frame.scene.splats, other.scene.splats
    return len(frame.tracks) == len(other.tracks) and all(
        np.array_equal(getattr(ours, name), getattr(theirs, name)) for name in vars(ours)
    )


def test_live_frames_without_loss_equal_the_offline_clip(frames):
    watched, stream = LivePath(frames, GROUP).run()
    whole = list(decode_frames(decode_stream(stream).scene))
    assert watched.reason == "complete"
    assert [frame.number for frame in watched.frames] == list(range(len(frames)))
    assert all(same(frame, other) for frame, other in zip(watched.frames, whole, strict=True))
    late = [at - ((n // GROUP + 1) * GROUP - 1) / FRAME_RATE for n, at in enumerate(watched.times)]
    assert max(late[GROUP:]) < GROUP / FRAME_RATE  # shown before the next group arrives


def test_every_frame_is_output_once_and_lost_keyframe_packets_are_retransmitted(frames):
    frames = [*frames, *reversed(frames)]
    watched, stream = LivePath(frames, GROUP, loss=0.2).run()
    whole = list(decode_frames(decode_stream(stream).scene))
    numbers = [frame.number for frame in watched.frames]
    assert numbers == list(range(numbers[0], len(frames)))
    assert numbers[0] < len(frames) - GROUP  # greetings are lost as well
    last = watched.frames[-1]
    assert len(last.tracks) == len(whole[-1].tracks)


@pytest.mark.parametrize("period_groups", [3, 100])
@pytest.mark.parametrize("joins", [0.0, 0.5, 0.9])
def test_receiver_misses_nothing_of_a_clip_since_it_joined(frames, joins, period_groups):
    watched, _ = LivePath(frames, GROUP, joins=joins, period_groups=period_groups).run()
    assert watched.missed == 0
    assert watched.reason in ("complete", "sent")


@pytest.mark.parametrize("joins", [0.0, 0.5])
@pytest.mark.parametrize("period_groups", [3, 100])
def test_lost_packets_of_a_clip_count_as_missed(frames, joins, period_groups):
    frames = [*frames, *reversed(frames), *frames]
    path = LivePath(frames, GROUP, loss=0.3, joins=joins, asks=False, period_groups=period_groups)
    watched, _ = path.run()
    assert watched.missed > 0


def test_empty_frames_are_shown_empty(frames):
    watched, _ = LivePath(darkened(frames, range(8, 16)), GROUP).run()
    assert [frame.number for frame in watched.frames] == list(range(len(frames)))
    assert [not len(frame.tracks) for frame in watched.frames] == [
        number in range(8, 16) for number in range(len(frames))
    ]


def test_late_receiver_starts_with_the_current_group(frames):
    watched, stream = LivePath(frames, GROUP, joins=0.5).run()
    whole = {frame.number: frame for frame in decode_frames(decode_stream(stream).scene)}
    first = watched.frames[0].number
    assert first == (0.5 * FRAME_RATE) // GROUP * GROUP - GROUP
    assert [frame.number for frame in watched.frames] == list(range(first, len(frames)))
    assert all(same(frame, whole[frame.number]) for frame in watched.frames)


@pytest.mark.parametrize(("loss", "joins"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.9)])
def test_receiver_continues_across_periods(frames, loss, joins):
    frames = [*frames, *reversed(frames)]
    path = LivePath(frames, GROUP, loss=loss, joins=joins, period_groups=3)
    watched, _ = path.run()
    numbers = [frame.number for frame in watched.frames]
    gaps = set(range(numbers[0], len(frames))) - set(numbers)
    assert numbers == sorted(set(numbers))
    assert not gaps if not loss else {gap % (3 * GROUP) for gap in gaps} <= set(range(GROUP))  # a welcome was lost
    assert joins * FRAME_RATE - 2 * GROUP <= numbers[0] <= joins * FRAME_RATE + (5 if loss else 2) * GROUP
    chapter, end = numbers[0] // (3 * GROUP), len(frames) // (3 * GROUP)
    assert [stream.manifest.stream_id - STREAM_ID for stream in watched.left] == list(range(chapter, end))
    if not loss:
        assert not any(frame.concealed.any() for frame in watched.frames)
        for stream in watched.left[1:]:  # each period is a complete clip
            assert len(stream.packets) == stream.manifest.num_packets
    else:
        shown = [frame for frame in watched.frames if end * 3 * GROUP - GROUP <= frame.number < end * 3 * GROUP]
        drawn = [int((frames[frame.number].opacities > 0).sum()) for frame in shown]
        assert all(len(frame.tracks) > 0.7 * count for frame, count in zip(shown, drawn, strict=True))  # half a second


@pytest.mark.extended
def test_memory_of_an_endless_live_clip_is_bounded():
    few = moving_frames(60, 4)
    LivePath(few, 2, period_groups=1).run(keep=False)  # excludes libraries and kernels that are loaded once
    path = LivePath(few * 10, 2, loss=0.05, period_groups=2)
    compared, held = {*range(4, 12), *range(15, 21)}, []
    path.each_group = lambda: held.append(_held() if len(held) in compared else None)
    tracemalloc.start()
    try:
        watched, _ = path.run(keep=False)
    finally:
        tracemalloc.stop()
    early, late = (
        [sum(line.size for line in snapshot.statistics("filename")) for snapshot in some]
        for some in (held[4:12], held[15:])
    )
    assert len(held) == 21
    grew = held[-1].compare_to(held[11], "lineno")[:5]
    assert max(late) < 1.2 * max(early), "\n".join(map(str, grew))
    assert watched.reason == "complete"


def _held() -> tracemalloc.Snapshot:
    """Memory held by the live code in bytes; allocations of other libraries in other threads do not count."""
    gc.collect()
    ours = str(Path(splatwire.__file__).parent / "*")
    return tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, ours)])


class CountedPackets(tuple):
    """Packets that count how many of them are read one after the other."""

    num_read = 0

    def __iter__(self):
        CountedPackets.num_read += len(self)
        return super().__iter__()

    def __getitem__(self, index):
        if isinstance(index, slice):
            return CountedPackets(super().__getitem__(index))
        CountedPackets.num_read += 1
        return super().__getitem__(index)


def packets_read_by_an_update(num_clients: int) -> int:
    """Number of packets that a server reads for the next group of a live stream of 1,000 packets."""
    snapshots = [
        LiveSnapshot(
            STREAM_ID, 256, bytes(32), 256, ((bytes(256),),), CountedPackets([bytes(100)] * count), 1150, 0,
            (ParityRange(0, 0, 0),), (), ((INIT_SYMBOL, 0, 0), *((DATA, 0, number) for number in range(count))),
            is_live=True, persistent=bytes([1] * count), newest_start=count - 10,
        )
        for count in (1000, 1010)
    ]  # fmt: skip
    limits = ServerLimits(per_network=num_clients)
    server = Server({"live": snapshots[0]}, secret=bytes(16), random=random.Random(1).randbytes, limits=limits)
    for client in range(num_clients):
        server.receive(("192.0.2.1", client), encode(Request(client, bytes(16), "live")), 0.0, reliable=True)
    assert server.num_transfers == num_clients
    CountedPackets.num_read = 0
    server.set_stream("live", snapshots[1])
    return CountedPackets.num_read


def test_packets_of_a_group_are_read_once_for_all_clients():
    first, more = packets_read_by_an_update(1), packets_read_by_an_update(20)
    assert more - first <= 19 * 10  # the new packets for each client


def test_slow_path_drops_motion_packets_and_no_keyframe_packets():
    frames = moving_frames(2500, 33)
    path = LivePath(frames, GROUP, rate=60_000.0)
    watched, stream = path.run()
    assert [frame.number for frame in watched.frames][-1] == len(frames) - 1
    assert any(frame.concealed.any() for frame in watched.frames)
    left = {place for place, _ in watched.sent}
    assert {place for place, lasts in enumerate(path.persistent) if lasts} <= left
    assert len(left) < len(stream.packets)
    for place, newest in watched.sent:
        assert path.persistent[place] or place >= path.first_packets[newest]
    # of each group's motion, only its most important first part is sent
    for begin, end in itertools.pairwise(path.first_packets):
        motion = [place in left for place in range(begin, end) if not path.persistent[place]]
        assert motion == sorted(motion, reverse=True)


def test_packets_of_each_block_are_sent_by_importance():
    encoder = SequenceEncoder(SequenceOptions(group_frames=2), lambda splats: np.zeros(splats.num_gaussians, np.int64))
    for splats in moving_frames(24000, 2):
        packets = encoder.push(splats)
    manifest, _ = encoder.current_header(STREAM_ID)
    stream = encoder.finish()
    persistent = [manifest.plan.is_keyframe(packet.id.block) for packet in packets]
    assert persistent == sorted(persistent, reverse=True)
    offline, found = stream_importance(stream), encoder.importance(packets)
    motion = [importance for importance, lasts in zip(found, persistent, strict=True) if not lasts]
    assert len(motion) > 3
    blocks = [packet.id.block for packet, lasts in zip(packets, persistent, strict=True) if not lasts]
    turns = [blocks[:index].count(block) for index, block in enumerate(blocks)]
    assert turns == sorted(turns)
    for _, some in itertools.groupby(zip(turns, motion, strict=True), lambda pair: pair[0]):
        importance = [own for _, own in some]
        assert importance == sorted(importance, reverse=True)
    for block in set(blocks):
        importance = [own for own, other in zip(motion, blocks, strict=True) if other == block]
        assert importance == sorted(importance, reverse=True)
    wanted = [offline[packet.id] for packet, lasts in zip(packets, persistent, strict=True) if not lasts]
    assert motion == pytest.approx(wanted, rel=0.2)
    bases = found[: len(found) - len(motion)]
    assert bases == sorted(bases, reverse=True)


def test_recorded_live_stream_decodes_as_a_clip(frames):
    encoder, broadcast = SequenceEncoder(SequenceOptions(group_frames=GROUP)), LivePackager()
    for splats in frames[: 2 * GROUP]:
        packets = encoder.push(splats)
        if packets:
            edition = broadcast.add(*encoder.current_header(STREAM_ID), packets)
    manifest, side_info = encoder.current_header(STREAM_ID)
    assert len(edition.packets) == manifest.num_packets
    whole = encoder.finish()
    assert manifest.symbols_digest == whole.manifest.symbols_digest
    said, sections = split_sections(whole.side_info, TRACKS)
    assert sections.pop(EXTENT_SECTION)  # excludes clips that have ended
    assert split_sections(side_info, TRACKS) == (said, sections)
    assert not any(edition.packets[n] for n in range(edition.newest_start) if not edition.persistent[n])


def test_frames_of_which_no_gaussian_has_arrived_are_not_output_as_empty_ones(frames):
    """As after a restart of the server: the next group may begin before the first keyframe packet arrives."""
    encoder, groups = SequenceEncoder(SequenceOptions(group_frames=GROUP)), []
    for splats in frames[: 3 * GROUP]:
        if packets := encoder.push(splats):
            groups.append((*encoder.current_header(STREAM_ID), packets))
    decoder, shown = LiveDecoder(), list[int]()
    arrived = [[], groups[0][2] + groups[1][2], groups[2][2]]
    for (manifest, side_info, _), packets in zip(groups, arrived, strict=True):
        shown += [frame.number for frame in (*decoder.update_header(manifest, side_info), *decoder.add(packets))]
    assert shown == [*range(GROUP, 3 * GROUP)]


def test_decoder_refuses_a_manifest_that_contradicts_earlier_ones(frames):
    encoder = SequenceEncoder(SequenceOptions(group_frames=GROUP))
    for splats in frames[:GROUP]:
        encoder.push(splats)
    manifest, side_info = encoder.current_header(STREAM_ID)
    decoder = LiveDecoder()
    list(decoder.update_header(manifest, side_info))
    first, second = manifest.tiers
    other = dataclasses.replace(
        manifest, tiers=(TierCounts(first.num_elements - 1, 1), TierCounts(second.num_elements + 1, 1))
    )
    with pytest.raises(BitstreamError, match="contradicts the previous one"):
        list(decoder.update_header(other, side_info))


def test_stream_updates_with_a_wrong_packet_count_are_refused(frames):
    encoder = SequenceEncoder(SequenceOptions(group_frames=GROUP))
    packets = [packet for splats in frames[:GROUP] for packet in encoder.push(splats)]
    with pytest.raises(InvalidValueError, match="packets, and the manifest says"):
        LivePackager().add(*encoder.current_header(STREAM_ID), packets[1:])


def test_receiver_waits_while_the_server_is_not_ready():
    server = Server({}, secret=bytes(16), random=bytes)
    receiver, now = Receiver(5, 0.0), 0.0
    while now < 40:
        now += 0.05
        for data in receiver.poll(now)[0]:
            answer = server.receive("client", data, now)
            while answer is not None:
                out, _ = receiver.receive(answer, now)
                answer = server.receive("client", out[0], now) if out else None
    assert receiver.finished is None
    while not receiver.finished:  # no peer answers after this point
        now += 0.05
        receiver.poll(now)
    assert receiver.finished.reason == "the server fell silent"
    assert receiver.options.reconnect_s - 5 < now - 40 < receiver.options.reconnect_s + 5


def test_receiver_accepts_only_growing_welcomes():
    def welcome(session: int, count: int, digest: bytes = b"a" * 32, more: bool = True) -> Welcome:
        tiers = (ParityRange(count, 0, 0),)
        return Welcome(5, session, 9, 1000, digest, 256, count, 1150, 0, tiers, is_live=more)

    receiver = Receiver(5, 0.0, reliable=True)
    receiver.poll(0.0)
    receiver.receive(encode(welcome(1, 10)), 0.1)
    for wrong in (welcome(2, 20), welcome(1, 9, b"b" * 32)):
        before = receiver.num_rejected
        receiver.receive(encode(wrong), 0.2)
        assert receiver.num_rejected == before + 1
        assert receiver.welcome == welcome(1, 10)
    assert receiver.receive(encode(welcome(1, 10)), 0.3) == ([], [])
    _, events = receiver.receive(encode(welcome(1, 20, b"b" * 32)), 0.4)
    assert (events[0].num_packets, events[0].is_live) == (20, True)
    receiver.receive(encode(welcome(1, 20, b"c" * 32, more=False)), 0.5)
    assert receiver.receive(encode(welcome(1, 30)), 0.6) == ([], [])
    assert decode(encode(welcome(1, 3))).is_live


def test_packets_ahead_of_their_welcome_are_kept(frames):
    ids, found = itertools.count(STREAM_ID), []
    clip = LiveEncoder(SequenceOptions(group_frames=GROUP), lambda: next(ids), period_groups=2)
    for splats in frames[: 3 * GROUP]:
        found += [edition] if (edition := clip.push(splats)) else []
    server = Server({"live": found[0]}, secret=bytes(16), random=bytes, limits=ServerLimits(fixed_rate=1e6))
    receiver, left, now = Receiver(5, 0.0, reliable=True), [], 0.0

    def deliver(some: list[bytes]) -> None:
        for data in some:
            for answer in receiver.receive(data, now)[0]:
                server.receive("client", answer, now, reliable=True)

    for edition in found:
        server.set_stream("live", edition)
        for _ in range(200):
            now += 0.01
            for data in receiver.poll(now)[0]:
                answer = server.receive("client", data, now, reliable=True)
                left += [answer] if answer else []
            left += [data for _, data in server.poll(now)]
            if receiver.welcome is None:
                deliver(left)
                left = []
        deliver([data for data in left if message_kind(data) == DATA])
        deliver([data for data in left if message_kind(data) != DATA])
        left = []
        stream = receiver.stream()
        assert stream is not None
        assert (stream.manifest.stream_id, receiver.num_rejected) == (edition.stream_id, 0)
        assert len(stream.packets) == len(edition.packets)


def test_parity_restores_motion_without_retransmission(frames):
    bare, _ = LivePath(frames, GROUP, loss=0.1, asks=False).run()
    protection = dataclasses.replace(PROTECTION, motion=((1.0, 1.0),))
    watched, stream = LivePath(frames, GROUP, loss=0.1, protection=protection, asks=False).run()
    motion = {p.id for p in stream.packets if not stream.manifest.plan.is_keyframe(p.id.block)}
    assert bare.repaired == 0
    assert watched.repaired > 0
    assert len(motion - watched.arrived) < len(motion - bare.arrived) / 2


def test_group_code_numbers_are_stable_and_protect_the_most_important_packets(frames):
    encoder = SequenceEncoder(SequenceOptions(group_frames=GROUP))
    broadcast = LivePackager(dataclasses.replace(PROTECTION, motion=((0.5, 0.5),)), encoder.importance)
    found = None
    for splats in frames[: 3 * GROUP]:
        packets = encoder.push(splats)
        if not packets:
            continue
        edition = broadcast.add(*encoder.current_header(STREAM_ID), packets)
        groups = parity_groups(edition.parity_ranges)
        alive = [number for number, group in enumerate(groups) if group.repair]
        assert len(alive) == 1
        assert found is None or alive[0] > found
        found, own = alive[0], groups[alive[0]]
        assert {group for kind, group, _ in edition.schedule if kind == PARITY} == {found}
        newest = [packet_from_bytes(data, STREAM_ID) for data in edition.packets[edition.newest_start :]]
        importance = encoder.importance(newest)
        start = own.start - edition.newest_start
        inside = importance[start : start + own.size]
        outside = importance[start + own.size :]
        assert inside
        assert not outside or min(inside) >= max(outside)


def test_announced_millions_of_tracks_allocate_no_memory():
    real, _ = read_stream(Path(__file__).parents[1] / "golden" / "tiny_clip.swz")
    announced = of_tracks(real, 1600, 64, bases=False, motion=1)
    decoder = LiveDecoder()
    assert list(decoder.update_header(announced.manifest, announced.side_info)) == []
    assert list(decoder.add(announced.packets)) == []
    with pytest.raises(BitstreamError, match=VARIABLE):
        list(decoder.finish())
