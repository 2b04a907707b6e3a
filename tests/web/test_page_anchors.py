"""The page with a stream of the causal codec: neural heads run again when the camera turns."""

import asyncio
import base64

import pytest

from scenes import tiny_causal_scene
from splatwire.bitstream import Packetization, SceneStream, stream_to_bytes
from splatwire.codec import encode_scene
from splatwire.transport import make_served_stream
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.pack import pack_stream
from splatwire.transport.http.server import PageServer
from transport.chromium import Browser, executable, isolated_page
from web.pictures import ELEMENT, check_concealed, check_pictures, half_of
from web.sketched import with_sketch

pytestmark = pytest.mark.slow

STATUS = f"{ELEMENT}?.status"
PANEL = f"{ELEMENT}.shadowRoot.querySelector('.panel').innerText"


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    packetization = Packetization(block_size=600, lanes=1, grouping="hashed", packet_bytes=900)
    return encode_scene(tiny_causal_scene(seed=7, num_anchors=600), packetization)


def test_packed_page_contains_anchors(stream: SceneStream) -> None:
    held = pack_stream(stream, "anchors").decode().partition('id="stream">')[2].partition("<")[0]
    assert base64.b64decode(held) == stream_to_bytes(stream)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_browser_renders_anchors(stream: SceneStream) -> None:
    """Covers integers, pictures, another camera, and packets that the user drops."""

    async def work() -> None:
        half = half_of(with_sketch(stream))
        async with PageServer(
            PageContent({"anchors": make_served_stream(stream), "half": stream_to_bytes(half)})
        ) as server:

            def drive() -> None:
                with isolated_page() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS} && {STATUS}.finished === 'complete' && {STATUS}.gaussians > 0")
                    assert page.resolve(f"{ELEMENT}.verify()") is True
                    check_pictures(page, stream, 38)
                    check_turning(page)
                    check_concealment(page)
                    check_concealed(page, f"{server.url}?stream=half", half, 34)  # large anchors are sorted as a whole

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 1800))


def check_turning(page: Browser) -> None:
    """The Gaussians of a view are computed when the camera turns."""
    page.evaluate(
        f"{{const view = {ELEMENT}.view, add = view.add.bind(view); window.answers = [];"
        " view.add = (...given) => { window.answers.push(given[1]); add(...given); }}"
    )
    page.evaluate(f"{ELEMENT}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'ArrowLeft', bubbles: true}}))")
    page.wait_for("window.answers.length > 0 && window.answers.every((replaceAll) => replaceAll)")


def check_concealment(page: Browser) -> None:
    """Packets that the user drops lower the quality, and `grow` enlarges the rest."""
    page.evaluate(f"{ELEMENT}.controlPanel.open = true")
    for concealer in ("drop", "grow"):
        page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.3, show: 'received', concealer: '{concealer}'}})")
        try:
            page.wait_for(f"/PSNR\\s+[0-9.]+ dB/.test({PANEL})")
        except TimeoutError:
            raise AssertionError(page.evaluate(f"{PANEL} + JSON.stringify(window.answers)")) from None
        assert not page.evaluate(f"/dropped on purpose\\s+0 packets/.test({PANEL})")
