"""A transfer that is relayed while it arrives: every reader gets the same file at any time."""

import asyncio
import itertools
import struct
from collections.abc import Callable
from dataclasses import replace

import pytest

from moving_sequences import moving_frames
from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splatwire.bitstream import (
    Manifest,
    PacketIntake,
    Packetization,
    SceneStream,
    packet_from_bytes,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.bitstream.sections import with_section
from splatwire.codec import encode_scene
from splatwire.errors import BitstreamError, InvalidValueError, MissingSideInfoError
from splatwire.sequence import SequenceOptions
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived, Welcomed, fec
from splatwire.transport.protocol.events import Resumed
from splatwire.transport.protocol.layout import SourceBlocks, split_init_segment
from splatwire.view import Relay, relay
from splatwire.view.page import page_of_relay, page_of_stream

HASHED = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=900)


def sent(stream: SceneStream, *, lose_every: int = 10**9) -> list[Event]:
    """Events of a receiver for a stream with some lost packets."""
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
    """Files of three readers: one before the start, one in the middle, and one late."""

    async def file() -> bytes:
        return b"".join([piece async for piece in relay.pieces()])

    early, running = asyncio.create_task(file()), asyncio.create_task(relay.run())
    await relay.begun()
    middle = asyncio.create_task(file())
    await running
    return [await early, await middle, await file()]


@pytest.mark.parametrize("lose_every", [3, 10**9])
def test_every_reader_gets_the_received_packets(lose_every: int) -> None:
    stream = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    found = asyncio.run(files(relay_of(sent(stream, lose_every=lose_every))))
    assert found[0] == found[1] == found[2]
    arrived, _ = stream_from_bytes(found[0])
    assert arrived.manifest == stream.manifest
    kept = [packet for n, packet in enumerate(stream.packets) if (n + 1) % lose_every]
    assert arrived.packets == tuple(kept)


def test_streams_unsupported_by_browsers_are_refused() -> None:
    stream = encode_scene(tiny_scene(num_anchors=200), HASHED)
    with pytest.raises(InvalidValueError, match="not for browsers"):
        asyncio.run(asyncio.wait_for(files(relay_of(sent(stream))), 60))
    with pytest.raises(InvalidValueError, match="not for browsers"):
        page_of_stream("a", stream, None, "127.0.0.1")


def test_slow_reader_gets_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "AT_ONCE", 2000)
    stream = encode_scene(tiny_causal_scene(num_anchors=400), HASHED)
    handed_on = relay_of(sent(stream))

    async def sizes() -> list[int]:
        await handed_on.run()
        return [len(piece) async for piece in handed_on.pieces()]

    _, *found = asyncio.run(sizes())
    assert len(found) > 2
    assert max(found) < 2000 + HASHED.packet_bytes + 8


def test_transfer_without_a_scene_is_refused() -> None:
    with pytest.raises(MissingSideInfoError, match=r"udp://nowhere: no scene arrived \(deadline\)"):
        asyncio.run(files(relay_of([Finished("deadline", False)])))


@pytest.mark.parametrize("reason", ["complete", "seen", "sent", "deadline", "the server stopped"])
@pytest.mark.parametrize("is_live", [False, True])
def test_reason_of_an_incomplete_transfer_is_kept(reason: str, is_live: bool) -> None:
    stream = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    handed_on = relay_of([*sent(stream)[:3], Finished(reason, True)])
    handed_on.was_live = is_live
    assert handed_on.failure() == ""
    asyncio.run(handed_on.run())
    complete = reason in ("complete", "seen") or (reason == "sent" and is_live)
    assert handed_on.failure() == ("" if complete else reason)


def test_failure_is_reported_and_ends_the_file() -> None:
    stream = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    broken = SideInfoArrived(stream.manifest, stream.side_info[:-40], PacketIntake(stream.manifest))
    for events, failure in (([broken], None), (sent(stream)[:3], BitstreamError("gone"))):
        with pytest.raises(BitstreamError):
            asyncio.run(asyncio.wait_for(files(relay_of(events, failure)), 60))


def test_page_gets_the_current_period_of_a_live_clip() -> None:
    """Each group of frames has a new head; a file has one, and memory does not grow from period to period."""
    frames, ids = moving_frames(80, 24), itertools.count(7)
    clip = LiveEncoder(SequenceOptions(group_frames=2), lambda: next(ids), period_groups=3)
    editions = [edition for splats in frames if (edition := clip.push(splats))]
    events: list[Event] = []
    for edition in editions:
        manifest, side_info = head_of(edition)
        events += [Welcomed(len(edition.packets), len(side_info), is_live=True)]
        events += [SideInfoArrived(manifest, side_info, PacketIntake(manifest))]
        new = edition.packets[edition.newest_start :]
        events += [PacketArrived(packet_from_bytes(data, edition.stream_id), False) for data in new]
    handed_on = relay_of(events)
    kept: list[int] = []

    async def work() -> list[bytes]:
        running = asyncio.create_task(handed_on.run())
        await handed_on.begun()
        assert handed_on.was_live
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
    source_blocks, data = SourceBlocks(edition.init_segment_bytes, edition.symbol_bytes), b""
    for number in range(source_blocks.num_blocks):
        span, size = source_blocks.span(number), source_blocks.size(number)
        found = fec.recover(dict(list(enumerate(edition.init_symbols[number]))[:size]), size, edition.symbol_bytes)
        assert found is not None
        data += b"".join(found)[: span.stop - span.start]
    manifest, side_info, _ = split_init_segment(data)
    return manifest, side_info


def test_other_stream_after_an_outage_starts_another_file() -> None:
    first = encode_scene(tiny_causal_scene(num_anchors=200), HASHED)
    other = encode_scene(tiny_causal_scene(seed=1, num_anchors=200), HASHED)
    events = [*sent(first)[:-3], Resumed(False), *sent(other)]
    found = asyncio.run(files(relay_of(events)))
    assert stream_from_bytes(found[-1])[0].manifest == other.manifest
    assert stream_from_bytes(found[-1])[0].packets == other.packets


def test_a_page_begins_where_a_camera_in_world_coordinates_is():
    """Cameras become relative to the origin of the stream, which is in its side information, as for a file."""
    origin = (442_000.0, 5_443_000.0, 120.0)
    stream = with_section(encode_scene(tiny_causal_scene()), "origin", struct.pack("<3d", *origin))
    cameras = replace(tiny_cameras(1), origin=origin).relative_to((0.0, 5_443_000.0, 0.0))

    async def work() -> None:
        handed_on = relay_of([Welcomed(3, 5, b"seen first"), *sent(stream)])
        running = asyncio.create_task(handed_on.run())
        await handed_on.headed()
        page = page_of_relay("a", handed_on, cameras, "127.0.0.1")
        words = page_of_stream("a", stream, cameras, "127.0.0.1").attributes["viewpoint"]
        assert page.attributes["viewpoint"] == words
        assert all(abs(float(word)) < 1000 for word in words.split())
        await running

    asyncio.run(work())
