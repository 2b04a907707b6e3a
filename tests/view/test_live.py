"""A scene that arrives over UDP while it is looked at."""

import asyncio
import json
import queue
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.preview import Preview, PreviewFrame, preview_gaussians, write_preview
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.packets import PacketIntake, Packetization, SceneStream
from splatwire.render import render_scene
from splatwire.render.cpu import render_cpu
from splatwire.transport import (
    Event,
    Finished,
    PacketArrived,
    Receiver,
    ReceiverOptions,
    SideInfoArrived,
    Welcomed,
)
from splatwire.transport.address import parse_url
from splatwire.view.live import LiveTransfer
from splatwire.view.model import LAYERS, Settings, Viewer
from splatwire.view.page import page_of_pictures
from view.test_pictures import ASKED

CAMERA = tiny_cameras(num_views=1, width=48, height=32)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    packetization = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=700)
    return encode_scene(tiny_scene(seed=2, num_anchors=400), packetization)


@pytest.fixture
def port(stream) -> Iterator[int]:
    """A server in a thread of its own."""
    pytest.importorskip("raptorq")
    from splatwire.transport import make_program
    from splatwire.transport.udp import UdpServer

    found: list[int] = []
    stop, loop = threading.Event(), asyncio.new_event_loop()

    async def serve() -> None:
        server = UdpServer({"scene": make_program(stream)}, "127.0.0.1", 0)
        found.append(server.port)
        try:
            while not stop.is_set():
                await asyncio.sleep(0.05)
        finally:
            server.close()

    thread = threading.Thread(target=lambda: (loop.run_until_complete(serve()), loop.close()))
    thread.start()
    while not found:
        time.sleep(0.01)
    yield found[0]
    stop.set()
    thread.join(10)


def transfer_from(port: int) -> LiveTransfer:
    from splatwire.transport.udp import receive_udp

    url = f"udp://127.0.0.1:{port}"
    address = parse_url(url)
    return LiveTransfer(url, lambda note: receive_udp(address, ReceiverOptions(), note))


def test_what_arrives_is_shown_and_in_the_end_everything(stream, port):
    tasks: dict[str, float] = {}
    transfer = transfer_from(port)
    source = transfer.start(tasks.__setitem__)
    viewer, end = Viewer(source), time.monotonic() + 60
    while True:
        status = viewer.frame(Settings(), CAMERA).status
        if status.packets_received == status.packets_total and source.note != "receiving":
            break
        assert time.monotonic() < end
    transfer.stop()
    assert "arrived" in status.note or "arrived" in source.note
    assert tasks["preparing the scene"] == 1.0
    assert status.known == stream.manifest.num_anchors
    truth = render_scene(decode_stream(stream).scene, CAMERA)[0]
    assert torch.equal(viewer.frame(Settings(), CAMERA).image, (truth * 255).round().to(torch.uint8))


def preview_bytes() -> bytes:
    frame = PreviewFrame.fitting((0.0,) * 3, 1.0, (-0.5, -0.5, -0.5, -2.0), (0.5, 0.5, 0.5, -1.0))
    return write_preview(Preview(frame, (0, 51, 102), np.random.default_rng(0).integers(0, 16, (20, 10))))


class Scripted:
    """Receives what a test hands over, when it does."""

    def __init__(self, *events: Event) -> None:
        self._events: queue.Queue[Event] = queue.Queue()
        self.hand_over(*events)

    def hand_over(self, *events: Event) -> None:
        for event in events:
            self._events.put(event)

    async def __call__(self, note) -> Receiver:
        while True:
            while self._events.empty():  # in slices, so that it can be stopped
                await asyncio.sleep(0.01)
            note(event := self._events.get())
            if isinstance(event, Finished):
                return Receiver(1, 0.0)


def arrival(stream: SceneStream) -> list[Event]:
    packets = [PacketArrived(packet, False) for packet in stream.packets]
    intake = PacketIntake(stream.manifest)
    for packet in stream.packets:
        intake.take(packet, "test")
    return [SideInfoArrived(stream.manifest, stream.side_info, intake), *packets, Finished("complete", True)]


def wait_for(what) -> None:
    end = time.monotonic() + 30
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_preview_is_shown_until_there_is_a_scene(stream):
    preview = preview_bytes()
    script = Scripted(Welcomed(len(stream.packets), 1000, preview))
    transfer = LiveTransfer("udp://somewhere", script)
    source = transfer.start(lambda *_: None)
    assert source.progressive is None
    viewer = Viewer(source)
    gaussians, background = preview_gaussians(preview)
    truth = render_cpu(gaussians, CAMERA, background=torch.tensor(background))[0].clamp(0, 1)
    for layer in LAYERS:
        frame = viewer.frame(Settings(layer=layer), CAMERA)
        assert int((frame.image.int() - (truth * 255).round().int()).abs().max()) <= 1
        assert (frame.status.bytes_sent, frame.status.psnr, frame.status.note) == (
            len(preview), None, "a preview, until the scene is there",
        )  # fmt: skip
    assert not source.has_scene
    script.hand_over(*arrival(stream))
    wait_for(lambda: source.has_scene)
    assert source.advance()
    assert source.preview is None
    wait_for(lambda: source.note == "everything has arrived")
    assert viewer.frame(Settings(), CAMERA).status.known == stream.manifest.num_anchors
    transfer.stop()


def test_a_preview_stays_when_no_scene_comes():
    transfer = LiveTransfer(
        "udp://somewhere", Scripted(Welcomed(5, 1000, preview_bytes()), Finished("deadline", False))
    )
    source = transfer.start(lambda *_: None)
    wait_for(lambda: "no scene arrived (deadline)" in source.status().note)
    assert not source.advance()
    assert source.preview is not None
    transfer.stop()


def test_side_information_that_cannot_be_read_leaves_the_preview(stream):
    script = Scripted(Welcomed(5, 1000, preview_bytes()))
    transfer = LiveTransfer("udp://somewhere", script)
    source = transfer.start(lambda *_: None)
    script.hand_over(SideInfoArrived(stream.manifest, stream.side_info[:-1], PacketIntake(stream.manifest)))
    wait_for(lambda: source.has_scene)
    with pytest.raises(BitstreamError):
        source.advance()
    assert not source.advance()
    assert Viewer(source).frame(Settings(), CAMERA).image.any()
    transfer.stop()


def test_a_damaged_preview_is_told_and_does_no_harm(stream):
    transfer = LiveTransfer("udp://somewhere", Scripted(Welcomed(5, 1000, b"\x01nonsense"), *arrival(stream)[:-1]))
    source = transfer.start(lambda *_: None)
    assert source.preview is None
    assert source.progressive is not None
    assert "receiving; what should have been its preview: " in source.note
    transfer.stop()


def test_the_page_goes_over_to_the_scene(stream):
    """It asks again for as long as something is pending."""
    script = Scripted(Welcomed(len(stream.packets), 1000, preview_bytes()))
    transfer = LiveTransfer("udp://somewhere", script)
    source = transfer.start(lambda *_: None)
    content = page_of_pictures(source, None, "127.0.0.1", "cpu", None, lambda *_: None)
    assert "live" in content.attributes
    assert content.pictures is not None
    before, told = content.pictures(ASKED)
    assert json.loads(told)["pending"]
    assert json.loads(told)["total"] == 0
    script.hand_over(*arrival(stream))
    wait_for(lambda: source.note == "everything has arrived")
    after, told = content.pictures(ASKED)
    assert not json.loads(told)["pending"]
    assert json.loads(told)["known"] == stream.manifest.num_anchors
    assert before != after
    transfer.stop()


def test_a_transfer_can_be_stopped_at_any_time(port):
    transfer = transfer_from(port)
    transfer.start(lambda *_: None)
    transfer.stop()
    transfer.stop()
    assert not [thread for thread in threading.enumerate() if thread.name == "splatwire-receive" and thread.is_alive()]


def test_nobody_there_is_an_error_that_says_so():
    transfer = transfer_from(1)
    with pytest.raises(MissingSideInfoError, match=r"udp://127.0.0.1:1: no scene arrived"):
        transfer.start(lambda *_: None)
    transfer.stop()
