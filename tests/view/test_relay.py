"""A transfer that is handed on while it arrives: whoever asks, and whenever, gets the same file."""

import asyncio
from collections.abc import Callable

import pytest

from scenes import tiny_causal_scene, tiny_scene
from splatwire.codec import encode_scene
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.packets import COLUMNS, PacketIntake, Packetization, SceneStream, stream_from_bytes
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived
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
