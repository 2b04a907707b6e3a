"""Visitors who come back with the back button: the browser has kept the page, and interrupted streams go on."""

import asyncio
from pathlib import Path

import pytest

from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.pictures import ELEMENT
from web.test_page import STATUS, run
from web.test_page_live import GROUP, NUMBER, editions, live_server

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
GOLDEN = Path(__file__).parent.parent / "golden"
OTHER = "another page"
REASONS = "JSON.stringify(performance.getEntriesByType('navigation')[0].notRestoredReasons)"


def leave(page: Browser, url: str) -> None:
    page.evaluate("window.isKept = false; addEventListener('pageshow', ({persisted}) => { isKept = persisted; })")
    page.open(f"{url}other")
    page.wait_for("location.pathname === '/other' && document.readyState === 'complete'")


def come_back(page: Browser) -> None:
    """Goes back to the page, which the browser has kept with its scripts and workers."""
    page.go_back()
    page.wait_for("location.pathname !== '/other' && document.readyState === 'complete'")
    assert page.evaluate("window.isKept"), page.evaluate(REASONS)


@pytest.mark.parametrize(
    ("file", "attributes"),
    [("tiny_causal", ""), ("tiny_causal", "updates"), ("tiny_clip", ""), ("tiny_levels", "")],
)
def test_the_browser_keeps_a_page_with_the_element(file: str, attributes: str) -> None:
    """It keeps none that has used WebXR."""
    tag = f'<script type="module" src="splatwire.js"></script><splat-wire src="scene.swz" {attributes}></splat-wire>'
    streams = {"scene.swz": (GOLDEN / f"{file}.swz").read_bytes()}

    def drive(url: str) -> None:
        with isolated_page() as page:
            page.open(f"{url}page")
            page.wait_for(f"{STATUS}?.verified && {ELEMENT}.view")
            for _ in range(2):
                leave(page, url)
                come_back(page)
                assert page.resolve(f"{ELEMENT}.verify()")
                assert not page.evaluate(f"{STATUS}.failed")

    async def work() -> None:
        async with hosting({"page": tag, "other": OTHER}, streams) as host:
            await asyncio.to_thread(drive, host.url)

    run(work())


@pytest.mark.parametrize("cut", ["away", "back"])
def test_a_visitor_who_leaves_while_a_stream_arrives_finds_it_whole(cut: str) -> None:
    """The connection breaks while the visitor is away, or after the return."""
    tag = '<script type="module" src="splatwire.js"></script><splat-wire src="scene.swz"></splat-wire>'
    file = (GOLDEN / "tiny_causal.swz").read_bytes()

    async def work() -> None:
        async with hosting({"page": tag, "other": OTHER}, {"scene.swz": file}) as host:
            host.deliver = lambda request, body: len(body) * 2 // 3

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}page")
                    page.wait_for(f"{STATUS}?.packets > 0")
                    leave(page, host.url)
                    host.deliver = lambda request, body: None
                    if cut == "away":
                        host.cut.set()
                    come_back(page)
                    host.cut.set()
                    page.wait_for(f"{STATUS}.verified")

            await asyncio.to_thread(drive)

    run(work())


def test_a_live_clip_goes_on_after_the_return() -> None:
    """The browser ends the session of a page that it keeps. The server's own pages may be kept."""
    served = editions(4)

    async def work() -> None:
        async with live_server() as (server, url):
            with isolated_page() as page:

                def visit() -> None:
                    page.open(url)
                    page.wait_for(f"{NUMBER} > 0")
                    leave(page, url)

                server.set_stream("live", served[0])
                await asyncio.to_thread(visit)
                for edition in served[1:]:
                    server.set_stream("live", edition)
                await asyncio.to_thread(come_back, page)
                await asyncio.to_thread(page.wait_for, f"{NUMBER} > {GROUP}")
                await asyncio.to_thread(page.wait_for, f"{STATUS}.finished === 'complete'")

    run(work())
