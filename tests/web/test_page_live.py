"""A live clip on a page: it waits for who wants no motion, conceals losses of each chapter, and says that it ends."""

import asyncio
import itertools
from contextlib import AsyncExitStack
from fractions import Fraction

import pytest

from moving_clips import moving_frames
from splatwire.clips import ClipOptions
from splatwire.clips.chapters import EndlessClip
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import Link, PageContent
from transport.chromium import browser, executable
from web.node import lacking
from web.test_page import STATUS, run
from web.test_page_clip import PANEL, TOLD, cell, slide
from web.test_page_visitors import found_by_axe

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.certificate import self_signed
from splatwire.transport.quic import WEBTRANSPORT_PATH
from splatwire.transport.quic_server import QuicServer

GROUP, RATE, CHAPTER, GROUPS = 3, 12, 3, 10
NUMBER = f"Number(({TOLD} || '0').replace(/\\D/g, ''))"
"""Of the frame that is on the screen, from 1."""


def editions(last: int) -> list:
    """What is served after each group of frames, the first ones of a clip that nobody knows the end of."""
    ids, frames = itertools.count(71), itertools.cycle(moving_frames(300, 9))
    clip = EndlessClip(ClipOptions(Fraction(RATE), GROUP), lambda: next(ids), chapter_groups=CHAPTER)
    found = [clip.push(next(frames)) for _ in range(last * GROUP)]
    return [edition for edition in [*found, *clip.end()] if edition is not None]


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_live_clip_plays_conceals_and_ends() -> None:
    served, identity = editions(GROUPS), self_signed()

    async def work() -> None:
        async with AsyncExitStack() as stack:
            server = QuicServer({}, "127.0.0.1", 0, identity=identity)
            stack.callback(server.close)
            await server.start()
            link = Link(server.port, WEBTRANSPORT_PATH, identity.fingerprint)
            pages = await stack.enter_async_context(PageServer(PageContent({"live": None}, link)))
            with browser() as page:

                async def seen(expression: str) -> object:
                    return await asyncio.to_thread(page.wait_for, expression, 60)

                async def served_to(end: int) -> None:
                    for edition in served[at[0] : end]:
                        server.renew("live", edition)
                        await asyncio.sleep(GROUP / RATE)
                    at[0] = end

                button, at = f"{PANEL}.querySelector('.player button')", [0]
                await served_to(2)
                await asyncio.to_thread(lambda: page.emulate(800, 600, prefers_reduced_motion="reduce"))
                await asyncio.to_thread(page.open, pages.url)
                assert await seen(f"{TOLD}?.startsWith('paused, frame') && {button}.textContent") == "play"
                first = await asyncio.to_thread(page.evaluate, NUMBER)
                await served_to(3)
                assert await asyncio.to_thread(page.evaluate, NUMBER) == first
                await asyncio.to_thread(page.evaluate, f"{button}.click()")
                assert GROUP < int(str(await seen(f"{TOLD}.startsWith('live') && {NUMBER}"))) <= 3 * GROUP
                await served_to(CHAPTER + 2)
                await seen(f"{NUMBER} > {(CHAPTER + 1) * GROUP}")
                assert await asyncio.to_thread(page.evaluate, cell("motion concealed")) == "none"
                await asyncio.to_thread(slide, page, "label input[type=range]", 0.6)
                await seen(f"{cell('motion concealed')}?.endsWith('tracks')")
                await asyncio.to_thread(page.evaluate, f"{button}.click()")
                held = await asyncio.to_thread(page.evaluate, NUMBER)
                assert lacking() or await asyncio.to_thread(found_by_axe, page) == []
                await served_to(2 * CHAPTER + 2)
                assert int(await asyncio.to_thread(page.evaluate, NUMBER)) <= int(str(held)) + 1
                await asyncio.to_thread(page.evaluate, f"{button}.click()")
                await served_to(len(served))
                await seen(f"{NUMBER} === {GROUPS * GROUP}")
                assert "held" in str(await seen(f"{PANEL}.querySelector('.laboratory').innerText"))
                assert await seen(f"{STATUS}.finished") == "complete"
                assert not await asyncio.to_thread(page.evaluate, f"{STATUS}.failed")

    run(work())
