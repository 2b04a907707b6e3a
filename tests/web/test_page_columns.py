"""The page with a stream of format 1, which the server decodes for it: the same pictures, the same concealers."""

import asyncio

import pytest

from scenes import tiny_scene
from splatwire.codec import encode_scene
from splatwire.packets import Packetization, SceneStream, stream_to_bytes
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import PageContent
from splatwire.view.columns import columns_of
from transport.chromium import browser, executable
from web.pictures import ELEMENT, check_concealed, check_pictures, half_of
from web.sketched import with_sketch

STATUS = f"{ELEMENT}?.status"
HASHED = Packetization(block_size=400, lanes=1, grouping="hashed", packet_bytes=900)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return with_sketch(encode_scene(tiny_scene(seed=7, num_anchors=400), HASHED))


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_browser_draws_what_the_server_decoded(stream: SceneStream) -> None:
    half = half_of(stream)
    content = {"whole": stream_to_bytes(columns_of(stream)), "half": stream_to_bytes(columns_of(half))}

    async def work() -> None:
        async with PageServer(PageContent(content)) as server:

            def drive() -> None:
                with browser() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS} && {STATUS}.finished === 'complete' && {STATUS}.gaussians > 0", 60)
                    check_pictures(page, stream, 38)
                    check_concealed(page, f"{server.url}?stream=half", half, 34)

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 240))
