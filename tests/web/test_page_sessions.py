"""A session that breaks: the next one, or HTTP, brings what is missing and nothing else."""

import asyncio
from contextlib import AsyncExitStack

import pytest

from explicit import encode_splats
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.errors import InvalidValueError
from splatwire.transport import ServerLimits, make_program
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import Link, PageContent
from transport.chromium import browser, executable
from web.host import WATCH
from web.pictures import ELEMENT
from web.test_page import SMALL, STATUS, ball, run

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.certificate import self_signed
from splatwire.transport.quic import WEBTRANSPORT_PATH
from splatwire.transport.quic_server import QuicServer

pytestmark = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
SLOW = ServerLimits(fixed_rate=30_000.0)
"""Bytes a second, at which the stream takes some seconds."""
LOST = "window.events.filter(([kind]) => kind === 'lost')"
LISTEN = WATCH.partition("<script>")[2].partition("</script>")[0]


@pytest.mark.parametrize("back", [True, False], ids=["session", "http"])
def test_a_session_that_breaks_is_followed_by_one_that_brings_the_rest(back: bool) -> None:
    stream = encode_splats(ball(6000), SMALL, quality=Quality(10.0))
    program, identity = make_program(stream), self_signed()

    async def work() -> None:
        async with AsyncExitStack() as stack:

            async def serving(port: int, limits: ServerLimits) -> QuicServer:
                server = QuicServer({"ball": program}, "127.0.0.1", port, identity=identity, limits=limits)
                stack.callback(server.close)
                await server.start()
                return server

            async def again(port: int) -> QuicServer:
                while True:
                    try:
                        return await serving(port, ServerLimits())
                    except InvalidValueError:  # the socket before closes in one of the next turns
                        await asyncio.sleep(0.01)

            first = await serving(0, SLOW)
            link = Link(first.port, WEBTRANSPORT_PATH, identity.fingerprint)
            pages = await stack.enter_async_context(PageServer(PageContent({"ball": program}, link)))
            with browser() as page:

                async def seen(expression: str) -> object:
                    return await asyncio.to_thread(page.wait_for, expression, 60)

                await asyncio.to_thread(page.open, pages.url)
                await seen(f"{STATUS}?.packets > {len(stream.packets) // 2}")
                await asyncio.to_thread(page.evaluate, f"{LISTEN}; {ELEMENT}.panel.open = true")
                first.close()
                second = await again(first.port) if back else None
                await seen(f"{STATUS}.verified")
                packets, way = await asyncio.to_thread(page.evaluate, f"[{STATUS}.packets, {STATUS}.way]")
                assert packets == len(stream.packets)
                assert ("datagrams" in way) is back
                assert len(await seen(LOST)) >= 1
                told = await seen(f"{ELEMENT}.shadowRoot.querySelector('.laboratory').innerText")
                assert "dropped once: the session ended" in " ".join(str(told).split())
                if second is not None:
                    assert second.bytes_sent < 0.6 * sum(program.sizes().values())

    run(work())
