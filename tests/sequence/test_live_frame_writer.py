"""Writing of received live frames: memory is bounded if writing is slower than arrival."""

import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from codec.gaussians.test_gaussians import DATAGRAM, some_splats
from explicit import encode_splats
from splatwire.bitstream import Manifest, Packet, PacketId, PacketIntake
from splatwire.sequence import waiting_events
from splatwire.sequence.decoding import SequenceFrame
from splatwire.sequence.live_decoder import LiveDecoder, frames_of_events
from splatwire.sequence.live_frame_writer import LiveFrameWriter
from splatwire.sequence.waiting_events import OBJECT_BYTES, WaitingEvents
from splatwire.transport import Event, PacketArrived, SideInfoArrived, StreamReplaced, Welcomed

PACKET = PacketArrived(Packet(PacketId(0, 0), 1, bytes(1000)), repaired=False)
STREAM = encode_splats(some_splats(), DATAGRAM)
HEAD = SideInfoArrived(STREAM.manifest, STREAM.side_info, PacketIntake(STREAM.manifest))
SIZE = 1000 + OBJECT_BYTES


def of_stream(number: int) -> SideInfoArrived:
    return replace(HEAD, manifest=replace(HEAD.manifest, stream_id=number))


def waiting(*events: Event) -> list[Event]:
    """Returns the events that leave a queue after some were put into it."""
    queue = WaitingEvents()
    for event in events:
        queue.put(event)
    queue.end()
    left = list(iter(queue.get, None))
    assert (queue.num_bytes, queue.empty()) == (0, True)
    return left


def test_packets_are_dropped_with_a_warning_if_frames_are_written_too_slowly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    written, going_on = list[Event](), threading.Event()

    def write(events, *_) -> None:
        going_on.wait()
        written.extend(iter(events.get, None))

    monkeypatch.setattr("splatwire.sequence.frame_writer.write_live_frames", write)
    monkeypatch.setattr(waiting_events, "MAX_WAITING_BYTES", 10 * SIZE)
    with LiveFrameWriter(tmp_path / "frames", None, lambda *_: None) as live:
        for event in (Welcomed(1, 1, is_live=True), *[PACKET] * 1000):
            live.on_event(event)
        live.on_event(HEAD)
        going_on.set()
        live.finish()
    assert live.num_dropped == 990
    assert [type(event) for event in written] == [*[PacketArrived] * 10, SideInfoArrived]
    assert [record.message.split(":")[0] for record in caplog.records] == [
        "frames are written more slowly than they arrive"
    ]


@pytest.mark.parametrize(("name", "writes_frames"), [("clip", True), ("clip.swz", False), ("clip.SWZ", False)])
def test_stream_files_get_no_frames(tmp_path: Path, name: str, writes_frames: bool) -> None:
    with LiveFrameWriter(tmp_path / name, None, lambda *_: None) as live:
        live.on_event(Welcomed(1, 1, is_live=True))
        assert live.writes_frames == live.began == (tmp_path / name).exists() == writes_frames


def test_memory_is_bounded_for_every_kind_of_event(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server may send manifests and replace its stream without end, too."""
    monkeypatch.setattr(waiting_events, "MAX_WAITING_BYTES", 10 * SIZE)
    queue, most = WaitingEvents(), 0
    for number in range(1000):
        for event in (of_stream(number), PACKET, PACKET, of_stream(number), StreamReplaced(STREAM)):
            queue.put(event)
            most = max(most, queue.num_bytes)
    init_segment_bytes = len(HEAD.side_info) + (1 + len(HEAD.manifest.tiers)) * OBJECT_BYTES
    assert 10 * SIZE <= most < 11 * SIZE + 2 * init_segment_bytes


def test_only_the_newest_of_adjacent_manifests_waits() -> None:
    first, second, other = of_stream(1), replace(of_stream(1), side_info=b"grown"), of_stream(2)
    assert waiting(first, Welcomed(1, 1, is_live=True), second) == [second]
    assert waiting(first, PACKET, second) == [first, PACKET, second]
    assert waiting(first, PACKET, second, StreamReplaced(STREAM), other) == [first, PACKET, second, other]


def test_packets_that_wait_together_are_decoded_together_and_before_the_next_manifest() -> None:
    """Also if no event follows a packet yet."""
    calls, queue = list[str](), WaitingEvents()

    class Decoder(LiveDecoder):
        def add(self, packets: Iterable[Packet]) -> Iterator[SequenceFrame]:
            calls.append(f"add {len(list(packets))}")
            yield from ()

        def update_header(self, manifest: Manifest, side_info: bytes) -> Iterator[SequenceFrame]:
            calls.append("header")
            yield from ()

    for event in (HEAD, PACKET, PACKET, HEAD, PACKET):
        queue.put(event)
    queue.end()
    assert list(frames_of_events(Decoder(), queue)) == []
    assert calls == ["header", "add 2", "header", "add 1"]
