"""Pictures that a page asks for are the viewer's, and nothing else is answered."""

import asyncio
import base64
import io
import json
import math
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.packets import Packetization, SceneStream
from splatwire.render import render_scene
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import PageContent
from splatwire.view.model import Settings, Viewer
from splatwire.view.page import page_of_pictures
from splatwire.view.pictures import Pictures
from splatwire.view.sources import FileSource
from transport.chromium import Browser, browser, executable

ASKED = urlencode(
    {"x": 0, "y": 0, "z": -4, "a": 1, "b": 0, "c": 0, "d": 0, "fov": 0.9, "width": 64, "height": 48, "drop": 0.0,
     "burst": 1, "seed": 0, "sent": 1, "score": 1, "concealer": "grow", "show": "received"}
)  # fmt: skip


def asked(**changes: object) -> str:
    return urlencode(dict(parse_qsl(ASKED)) | changes)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    packetization = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=700)
    return encode_scene(tiny_scene(seed=2, num_anchors=400), packetization)


@pytest.fixture(scope="module")
def content(stream: SceneStream) -> PageContent:
    return page_of_pictures(FileSource(stream), tiny_cameras(distance=4.0), "127.0.0.1", "cpu", None, lambda *_: None)


def test_a_picture_is_the_viewers_from_that_camera_under_those_losses(stream):
    viewer, camera = Viewer(FileSource(stream)), tiny_cameras(1, 64, 48)
    place, turn = camera.centers[0].tolist(), Rotation.from_matrix(camera.viewmats[0, :3, :3].T.numpy()).as_quat()
    pose = dict(zip("xyzbcda", [*place, *turn.tolist()], strict=True))
    fov = 2 * math.atan(24 / float(camera.Ks[0, 1, 1]))
    query = asked(**pose, fov=fov, drop=0.4, seed=3, concealer="idw", sent=0.8)
    jpeg, told = Pictures(viewer).answer(query)
    frame = viewer.frame(Settings(0.4, 1.0, 3, "idw", 0.8), camera)
    picture = np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB")).astype(float)
    other = viewer.frame(Settings(0.4, 1.0, 4, "idw", 0.8), camera)  # as far as another seed's is a JPEG never off
    assert 2 * np.abs(picture - frame.image.numpy()).mean() < np.abs(picture - other.image.numpy()).mean()
    told = json.loads(told)
    assert told["psnr"] == pytest.approx(frame.status.psnr, abs=0.01)
    assert (told["packets"], told["expected"]) == (frame.status.packets_received, len(stream.packets))
    assert json.loads(Pictures(viewer).answer(ASKED)[1])["psnr"] == "no loss"


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("", "asked for"), (asked(x="nan"), "'x'"), (asked(width=8000, height=8000), "pixels"), (asked(a=0), "no rot"),
        (asked(drop=1), "'drop'"), (asked(show="depth"), "difference"), (asked(fov="wide"), "asked for"),
        (asked(seed=-1), "'seed'"), (asked() + "&more=1", "asked for"), (asked(x="1e999"), "'x'"),
    ],
)  # fmt: skip
def test_what_is_no_picture_is_refused(content: PageContent, query: str, words: str):
    with pytest.raises(InvalidValueError, match=words):
        content.pictures(query)


def test_only_its_own_page_has_pictures_drawn(content: PageContent):
    """A page of another site cannot send the header without being asked whether it may, which gets no yes."""
    request = f"GET /picture?{ASKED} HTTP/1.1\r\nHost: 127.0.0.1"
    assert content.answer(request.encode()).startswith(b"HTTP/1.1 403")
    answer = content.answer(f"{request}\r\nSplatwire-Page: 1".encode())
    assert answer.startswith(b"HTTP/1.1 200")
    assert b"Access-Control" not in answer.partition(b"\r\n\r\n")[0]
    assert content.answer(b"OPTIONS /picture HTTP/1.1\r\nHost: 127.0.0.1").startswith(b"HTTP/1.1 405")
    wrong = f"GET /picture?{asked(concealer='magic')} HTTP/1.1\r\nHost: 127.0.0.1\r\nSplatwire-Page: 1"
    refusal = content.answer(wrong.encode())
    assert refusal.startswith(b"HTTP/1.1 400")
    assert b"unknown concealer" in refusal
    with pytest.raises(UnknownNameError):
        content.pictures(asked(concealer="magic"))


ELEMENT = "document.querySelector('splat-wire')"


def drawn(page: Browser) -> np.ndarray:
    """The picture on the canvas, once it is sharp."""
    page.wait_for(f"{ELEMENT}.status.finished")
    page.evaluate(f"{ELEMENT}.status.finished = null")
    data = page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('canvas.first').toDataURL().split(',')[1]")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(float)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_the_page_shows_pictures_and_follows_hands(stream: SceneStream, content: PageContent, tmp_path: Path):
    async def work() -> None:
        async with PageServer(content) as server:

            def drive() -> None:
                with browser() as page:
                    page.open(server.url)
                    page.wait_for(ELEMENT)
                    check_page(page, stream)

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 120))


def check_page(page: Browser, stream: SceneStream) -> None:
    first = drawn(page)
    height, width = first.shape[:2]
    camera = tiny_cameras(1, width, height, distance=4.0)
    lens = torch.tensor([[height / 2 / math.tan(math.radians(25)), 0, width / 2], [0, 0, height / 2], [0, 0, 1]])
    lens[1, 1] = lens[0, 0]
    camera = type(camera)(camera.viewmats, lens[None], width, height, camera.names)
    truth = render_scene(conceal(decode_stream(stream), "grow"), camera)[0].numpy() * 255
    assert np.abs(first - truth).mean() < 4
    page.evaluate(f"{ELEMENT}.panel.set({{dropped: 0.6, concealer: 'drop'}})")
    dropped = drawn(page)
    assert np.abs(dropped - first).mean() > 1
    assert page.evaluate(f"/PSNR[0-9.]+ dB/.test({ELEMENT}.shadowRoot.textContent)")
    page.drag((300, 300), (380, 330))
    assert np.abs(drawn(page) - dropped).mean() > 1
