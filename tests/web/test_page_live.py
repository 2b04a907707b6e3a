"""A live clip on a page: reduced motion, concealment in each period, and the end of the clip."""

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from moving_sequences import moving_frames
from splatwire.sequence import SequenceOptions
from splatwire.sequence.frames import Frame
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.server import PageServer
from splatwire.transport.protocol.live_packager import LiveSnapshot
from transport.chromium import executable, isolated_page
from web.node import lacking
from web.pictures import ELEMENT
from web.test_page import STATUS, run
from web.test_page_clip import PANEL, TOLD, cell, slide
from web.test_page_visitors import axe_findings

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer

pytestmark = pytest.mark.slow

GROUP, RATE, CHAPTER, GROUPS = 3, 12, 3, 10
NUMBER = f"Number(({TOLD} || '0').replace(/\\D/g, ''))"
"""Number of the shown frame, from 1."""
SPY = f"""(() => {{
  const {{ view }} = {ELEMENT}, set = view.antialias;
  window.antialiased = [];
  view.antialias = function (value) {{ antialiased.push(value); set.call(this, value); }};
  return true;
}})()"""
"""Records changes of antialiasing."""


def editions(last: int) -> list:
    """Served files after each group of frames, for a clip of unknown length."""
    ids, frames = itertools.count(71), itertools.cycle(moving_frames(300, 9))
    clip = LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: next(ids), period_groups=CHAPTER)
    found = [clip.push(next(frames)) for _ in range(last * GROUP)]
    return [edition for edition in [*found, *clip.end()] if edition is not None]


@asynccontextmanager
async def live_server() -> AsyncIterator[tuple[QuicServer, str]]:
    """A server of the live stream `live`, and the address of its page."""
    async with AsyncExitStack() as stack:
        identity = self_signed()
        server = QuicServer({}, "127.0.0.1", 0, identity=identity)
        stack.callback(server.close)
        await server.start()
        link = WebTransportEndpoint(server.port, WEBTRANSPORT_PATH, identity.fingerprint)
        pages = await stack.enter_async_context(PageServer(PageContent({"live": None}, link)))
        yield server, pages.url


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_live_clip_plays_with_concealment_and_ends() -> None:
    served = editions(GROUPS)

    async def work() -> None:
        async with live_server() as (server, url):
            with isolated_page() as page:

                async def seen(expression: str) -> object:
                    return await asyncio.to_thread(page.wait_for, expression)

                async def served_to(end: int) -> None:
                    for edition in served[at[0] : end]:
                        server.set_stream("live", edition)
                        await asyncio.sleep(GROUP / RATE)
                    at[0] = end

                button, at = f"{PANEL}.querySelector('.player button')", [0]
                await served_to(2)
                await asyncio.to_thread(lambda: page.emulate(800, 600, prefers_reduced_motion="reduce"))
                await asyncio.to_thread(page.open, url)
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
                assert lacking() or await asyncio.to_thread(axe_findings, page) == []
                await served_to(2 * CHAPTER + 2)
                assert int(await asyncio.to_thread(page.evaluate, NUMBER)) <= int(str(held)) + 1
                await asyncio.to_thread(page.evaluate, f"{button}.click()")
                await served_to(len(served))
                await seen(f"{NUMBER} === {GROUPS * GROUP}")
                assert "stalled" in str(await seen(f"{PANEL}.querySelector('.laboratory').innerText"))
                assert await seen(f"{STATUS}.finished") == "complete"
                assert not await asyncio.to_thread(page.evaluate, f"{STATUS}.failed")

    run(work())


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_live_clip_is_shown_at_localhost() -> None:
    """Chromium opens sessions with `localhost` at [::1] only, and the server listens on 127.0.0.1."""
    served = editions(2)

    async def work() -> None:
        async with live_server() as (server, url):
            with isolated_page() as page:
                await asyncio.to_thread(page.open, url.replace("127.0.0.1", "localhost"))
                for edition in served:
                    server.set_stream("live", edition)
                assert await asyncio.to_thread(page.wait_for, f"{STATUS}?.gaussians > 0 && {STATUS}.transport")

    run(work())


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_page_draws_a_live_clip_whose_source_changes_degree_and_antialiasing() -> None:
    """The source of the frames is replaced; a period begins with its settings."""
    ids, frames = itertools.count(71), moving_frames(300, GROUP)
    clip = LiveEncoder(SequenceOptions(Fraction(RATE), GROUP), lambda: next(ids))
    red = np.zeros((300, 3, 3))
    red[:, 1, 0] = 1.0
    kinds = [(frames, False), ([replace(one, sh=np.concatenate([one.sh, red], axis=1)) for one in frames], True)]
    served = list[list[LiveSnapshot]]()
    for splats, antialiased in [*kinds, kinds[0]]:
        clip.restart()
        found = [clip.push(Frame.of(one, antialiased=antialiased)) for _ in range(2) for one in splats]
        served.append([edition for edition in found if edition is not None])

    async def work() -> None:
        async with live_server() as (server, url):
            with isolated_page() as page:
                for part, editions in enumerate(served):
                    for edition in editions:
                        server.set_stream("live", edition)
                        await asyncio.sleep(GROUP / RATE)
                    if not part:
                        await asyncio.to_thread(page.open, url)
                        await asyncio.to_thread(page.wait_for, f"{ELEMENT}?.view?.shows")
                        await asyncio.to_thread(page.evaluate, SPY)
                    await asyncio.to_thread(page.wait_for, f"{NUMBER} === {2 * GROUP * (part + 1)}")
                    await asyncio.to_thread(page.wait_for, f"antialiased.length >= {part}")
                    assert await asyncio.to_thread(page.evaluate, "antialiased") == [True, False][:part]

    run(work())
