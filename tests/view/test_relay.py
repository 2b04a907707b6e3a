"""A transfer that is handed on while it arrives: whoever asks, and whenever, gets the same file."""

import asyncio
import itertools
from collections.abc import Callable

import pytest

from moving_clips import moving_frames
from scenes import tiny_causal_scene, tiny_scene
from splatwire.clips import ClipOptions
from splatwire.clips.chapters import EndlessClip
from splatwire.codec import encode_scene
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.packets import (
    COLUMNS,
    Manifest,
    PacketIntake,
    Packetization,
    SceneStream,
    packet_from_bytes,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived, Welcomed, fec
from splatwire.transport.events import Resumed
from splatwire.transport.layout import Segments, split_head_object
from splatwire.view import Relay, columns_of, relay

HASHED = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=900)


def sent(stream: SceneStream, *, lose_every: int = 10**9) -> list[Event]:
    """What a receiver tells of a stream, some packets lost."""
    intake = PacketIntake(stream.manifest)
    kept = [packet for n, packet in enumerate(stream.packets) if (n + 1) % lose_every]
    there: list[Event] = [PacketArrived(packet, False) for packet in kept]
    return [SideInfoArrived(stream.manifest, stream.side_info, intake), *there, Finished("sent", True)]


def relay_of(events: list[Event], failure: Exception | None = None) -> Relay:
    async def receive(note: Callable[[Event], None]) -> Receiver:
        for event in events:
            note(event)
            await asyncio.sleep(0)
        if failure:
            raise failure
        return None  # type: ignore[return-value]  # nobody looks at it

    return Relay("udp://nowhere", receive)


async def files(relay: Relay) -> list[bytes]:
    """What one gets who asks before anything is there, one who asks in the middle, and one who comes late."""

    async def file() -> bytes:
        return b"".join([piece async for piece in relay.pieces()])

    early, running = asyncio.create_task(file()), asyncio.create_task(relay.run())
    await relay.begun()
    middle = asyncio.create_task(file())
    await running
    return [await early, await middle, await file()]


@pytest.mark.parametrize("lose_every", [3, 10**9])
def test_everybody_gets_what_arrived(lose_every: int) -> None:
    stream = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    found = asyncio.run(files(relay_of(sent(stream, lose_every=lose_every))))
    assert found[0] == found[1] == found[2]
    arrived, _ = stream_from_bytes(found[0])
    assert arrived.manifest == stream.manifest
    kept = [packet for n, packet in enumerate(stream.packets) if (n + 1) % lose_every]
    assert arrived.packets == tuple(kept)


def test_what_browsers_do_not_decode_is_handed_on_as_columns() -> None:
    stream = encode_scene(tiny_scene(num_anchors=200), HASHED)
    found, _ = stream_from_bytes(asyncio.run(files(relay_of(sent(stream))))[0])
    assert found.manifest.codec == COLUMNS
    assert found.packets == columns_of(stream).packets


def test_one_who_reads_slowly_holds_a_little_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "AT_ONCE", 2000)
    stream = encode_scene(tiny_causal_scene(num_anchors=400), HASHED)
    handed_on = relay_of(sent(stream))

    async def sizes() -> list[int]:
        await handed_on.run()
        return [len(piece) async for piece in handed_on.pieces()]

    _, *found = asyncio.run(sizes())
    assert len(found) > 2
    assert max(found) < 2000 + HASHED.packet_bytes + 8


def test_a_transfer_without_a_scene_is_an_error() -> None:
    with pytest.raises(MissingSideInfoError, match="udp://nowhere"):
        asyncio.run(files(relay_of([Finished("deadline", False)])))


def test_what_goes_wrong_is_told_and_ends_the_file() -> None:
    stream = encode_scene(tiny_scene(num_anchors=200), HASHED)
    broken = SideInfoArrived(stream.manifest, stream.side_info[:-40], PacketIntake(stream.manifest))
    for events, failure in (([broken], None), (sent(stream)[:3], BitstreamError("gone"))):
        with pytest.raises(BitstreamError):
            asyncio.run(asyncio.wait_for(files(relay_of(events, failure)), 60))


def test_of_a_live_clip_a_page_gets_the_running_chapter_and_one_chapter_is_kept() -> None:
    """Each group of frames has a new head; a file has one, and what is kept does not grow from chapter to chapter."""
    frames, ids = moving_frames(80, 24), itertools.count(7)
    clip = EndlessClip(ClipOptions(group_frames=2), lambda: next(ids), chapter_groups=3)
    editions = [edition for splats in frames if (edition := clip.push(splats))]
    events: list[Event] = []
    for edition in editions:
        manifest, side_info = head_of(edition)
        events += [Welcomed(len(edition.packets), len(side_info), open=True)]
        events += [SideInfoArrived(manifest, side_info, PacketIntake(manifest))]
        new = edition.packets[edition.newest :]
        events += [PacketArrived(packet_from_bytes(data, edition.stream_id), False) for data in new]
    handed_on = relay_of(events)
    kept: list[int] = []

    async def work() -> list[bytes]:
        running = asyncio.create_task(handed_on.run())
        await handed_on.begun()
        assert handed_on.is_live
        found = []
        while not running.done():
            found.append(b"".join([piece async for piece in handed_on.pieces()]))
            kept.append(sum(map(len, handed_on._pieces)))
            await asyncio.sleep(0)
        return found

    found = asyncio.run(asyncio.wait_for(work(), 60))
    streams = [stream_from_bytes(file)[0] for file in found]
    assert {stream.manifest.stream_id for stream in streams} <= {7, 8, 9, 10}
    assert streams[-1].manifest.stream_id == 10
    assert len(streams[-1].packets) == streams[-1].manifest.num_packets
    chapter = len(stream_to_bytes(streams[-1]))
    assert max(kept) < 2 * chapter


def head_of(edition) -> tuple[Manifest, bytes]:
    """Manifest and side information of an edition."""
    segments, data = Segments(edition.head_bytes, edition.symbol_bytes), b""
    for number in range(segments.num_segments):
        span, size = segments.span(number), segments.size(number)
        found = fec.recover(dict(list(enumerate(edition.head[number]))[:size]), size, edition.symbol_bytes)
        assert found is not None
        data += b"".join(found)[: span.stop - span.start]
    manifest, side_info, _ = split_head_object(data)
    return manifest, side_info


def test_a_server_that_sends_another_stream_after_an_outage_begins_another_file() -> None:
    first = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    other = encode_scene(tiny_causal_scene(seed=1, num_anchors=200), HASHED)
    events = [*sent(first)[:-3], Resumed(False), *sent(other)]
    found = asyncio.run(files(relay_of(events)))
    assert stream_from_bytes(found[-1])[0].manifest == other.manifest
    assert stream_from_bytes(found[-1])[0].packets == other.packets
