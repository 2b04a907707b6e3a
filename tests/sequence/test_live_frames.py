"""Writing of received live frames: memory is bounded if frames are written more slowly than they arrive."""

import threading
from pathlib import Path

import pytest

from splatwire.bitstream import Packet, PacketId
from splatwire.sequence import live_frames
from splatwire.sequence.live_frames import LiveFrames
from splatwire.transport import Event, PacketArrived, Welcomed


def test_packets_are_dropped_with_a_warning_if_frames_are_written_too_slowly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    written, going_on = list[Event](), threading.Event()

    def write(waiting, *_) -> None:
        going_on.wait()
        written.extend(iter(waiting.get, None))

    monkeypatch.setattr("splatwire.sequence.written_frames.write_live_frames", write)
    monkeypatch.setattr(live_frames, "MAX_WAITING", 10)
    packet = PacketArrived(Packet(PacketId(0, 0), 1, b"1234"), repaired=False)
    joined = Welcomed(1, 1, is_live=True)
    with LiveFrames(tmp_path / "frames", None, lambda *_: None) as live:
        for event in (joined, *[packet] * 1000):
            live.note(event)
        assert live._waiting.qsize() == 10
        live.note(joined)
        going_on.set()
        live.finish()
    assert [type(event) for event in written] == [Welcomed, *[PacketArrived] * 9, Welcomed]
    assert [record.message.split(":")[0] for record in caplog.records] == [
        "frames are written more slowly than they arrive"
    ]
