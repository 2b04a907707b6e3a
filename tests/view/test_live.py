"""A scene that arrives over UDP while it is looked at."""

import asyncio
import threading
import time
from collections.abc import Iterator

import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import MissingSideInfoError
from splatwire.packets import Packetization, SceneStream
from splatwire.render import render_scene
from splatwire.transport import ReceiverOptions
from splatwire.transport.address import parse_url
from splatwire.view.live import LiveTransfer
from splatwire.view.model import Settings, Viewer

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
    assert status.anchors_known == stream.manifest.num_anchors
    truth = render_scene(decode_stream(stream).scene, CAMERA)[0]
    assert torch.equal(viewer.frame(Settings(), CAMERA).image, (truth * 255).round().to(torch.uint8))


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
