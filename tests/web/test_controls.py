"""User input on the page: mouse, touch and keyboard, embedding in another site, and an intermittent link."""

import asyncio
import re
import time
from contextlib import AsyncExitStack
from typing import Any

import pytest

from explicit import encode_splats
from splatwire.bitstream import SceneStream
from splatwire.codec.gaussians.quality import Quality
from splatwire.transport import ServedStream, ServerLimits, make_served_stream
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.server import PageServer
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer
from transport.chromium import Browser, executable, isolated_page
from transport.relay import Relay
from web.host import listening
from web.node import WEB
from web.test_page import ELEMENT, SMALL, STATUS, ball, run, status

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
ORBIT = f"{ELEMENT}.view.orbit"
TARGET = f"{ORBIT}.target"
LOOK = f"[{ORBIT}.yaw, {ORBIT}.pitch, {ORBIT}.distance, {TARGET}.x, {TARGET}.y, {TARGET}.z]"


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))


@pytest.fixture(scope="module")
def program(stream: SceneStream) -> ServedStream:
    return make_served_stream(stream)


def loaded(page: Browser, url: str) -> None:
    page.open(url)
    page.wait_for(f"{STATUS} && ({STATUS}.finished || {STATUS}.failed) && {ELEMENT}.view")


def changed(page: Browser, before: list[float]) -> list[bool]:
    return [abs(a - b) > 1e-4 for a, b in zip(page.evaluate(LOOK), before, strict=True)]


def test_mouse_touch_and_keyboard_move_the_camera(program: ServedStream) -> None:
    async def work() -> None:
        async with PageServer(PageContent({"ball": program})) as server:

            def drive() -> None:
                with isolated_page() as page:
                    page.emulate(800, 600)
                    loaded(page, server.url)
                    check_hands(page)

            await asyncio.to_thread(drive)

    run(work())


def check_hands(page: Browser) -> None:
    """Checks the effect of each movement: yaw and pitch, distance, or target of the orbit."""
    began = page.evaluate(f"String({LOOK})")
    for act, what in (
        (lambda: page.drag((200, 300), (260, 340)), "turn"),
        (lambda: page.wheel(200, 300, -120), "zoom"),
        (lambda: page.drag((200, 300), (260, 340), "right"), "move"),
        (lambda: page.touch([(200, 300)], [(240, 330)]), "turn"),
        (lambda: page.touch([(150, 300), (250, 300)], [(140, 300), (260, 300)], [(100, 300), (300, 300)]), "pinch"),
        (lambda: page.key("ArrowLeft"), "turn"),
        (lambda: page.key("+"), "zoom"),
    ):
        before = page.evaluate(LOOK)
        act()
        page.wait_for(f"String({LOOK}) !== '{page.evaluate(f'String({before})')}'")
        yaw, _, distance, *target = changed(page, before)
        assert [yaw, distance] == [what == "turn", what in ("zoom", "pinch")], what
        assert any(target) == (what != "turn"), "what is come nearer to is turned around"
    page.key("Home")
    page.wait_for(f"String({LOOK}) === '{began}'")
    page.key("f")
    assert page.evaluate(f"{ORBIT}.turned")
    page.key("h")
    assert page.evaluate(f"{ELEMENT}.controlPanel.element.hidden")


def documented(name: str) -> str:
    """The third-party page of a document."""
    [found] = re.findall(r"```html\n(.*?)```", (WEB.parent / "docs" / name).read_text(), re.DOTALL)
    return found


def test_element_works_on_a_third_party_site(program: ServedStream) -> None:
    async def work() -> None:
        async with AsyncExitStack() as stack:
            server = await stack.enter_async_context(PageServer(PageContent({"ball": program})))
            example = documented("browser.md").replace("http://127.0.0.1:8080/", server.url)
            body = example.replace("scene.swz", "ball.swz")
            page_of_theirs = f"<!doctype html>{body}<p>Their words.</p>".encode()

            async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
                await reader.readuntil(b"\r\n\r\n")
                writer.write(
                    b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\n\r\n" + page_of_theirs
                )
                await writer.drain()
                writer.close()

            theirs = await stack.enter_async_context(listening(answer))
            url = f"http://localhost:{theirs}/"

            def drive() -> None:
                with isolated_page() as page:
                    page.emulate(800, 600)
                    loaded(page, url)
                    assert status(page, "complete")
                    assert page.evaluate("location.origin") not in server.url
                    assert page.resolve(f"{ELEMENT}.verify()") is True
                    assert 400 < page.evaluate(f"{ELEMENT}.view.canvas.height") <= 480, "all of it, or under the bar"
                    assert "Their words." in page.evaluate("document.body.innerText")

            await asyncio.to_thread(drive)

    run(work())


def test_intermittent_link_resends_only_lost_packets(stream: SceneStream, program: ServedStream) -> None:
    """The link is down for two of every three quarters of a second; the transfer takes several of them."""
    identity, began = self_signed(), time.monotonic()

    def gone() -> bool:
        return (time.monotonic() - began) % 0.75 > 0.25

    async def work() -> None:
        async with AsyncExitStack() as stack:
            limits = ServerLimits(fixed_rate=20_000.0)
            server = QuicServer({"ball": program}, "127.0.0.1", 0, identity=identity, limits=limits)
            stack.callback(server.close)
            await server.start()
            relay = Relay(server.port, gone, gone, delay_s=0.003)
            stack.callback(relay.close)
            content = PageContent(
                {"ball": program}, WebTransportEndpoint(relay.port, WEBTRANSPORT_PATH, identity.fingerprint)
            )
            page_server = await stack.enter_async_context(PageServer(content))

            def drive() -> Any:
                with isolated_page() as page:
                    loaded(page, page_server.url)
                    return status(page, "finished"), status(page, "transport"), status(page, "packets")

            ended, transport, packets = await asyncio.to_thread(drive)
            assert (ended, transport, packets) == ("complete", "WebTransport datagrams", len(stream.packets))
            assert relay.num_lost > 20

    run(work())
