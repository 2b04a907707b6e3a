"""The page for visitors: no axe findings, a bar that leaves the scene visible, no unrequested motion."""

import asyncio
import base64
import contextlib
import io
import json
from collections.abc import AsyncIterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from explicit import encode_splats
from moving_sequences import moving_frames
from splatwire.bitstream import read_stream
from splatwire.cli._bundled import ASSETS, SPLATS
from splatwire.cli._run_serve import prepare_served_stream
from splatwire.codec.gaussians.quality import Quality
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.transport import Protection
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.pack import pack_stream, pack_streams
from splatwire.transport.http.server import PageServer
from splatwire.view.page import page_of_stream
from transport.chromium import Browser, executable, isolated_page
from web.host import listening
from web.node import WEB, lacking
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
ROOT = f"{ELEMENT}.shadowRoot"
WINDOWS = ((1280, 800, False), (390, 844, True))
SMALLEST = 44
"""Minimum size of a touch target, pixels."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> str:
    stream = encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))
    packed = tmp_path_factory.mktemp("visitors") / "ball.html"
    packed.write_bytes(pack_stream(stream, "a ball"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def tall(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene four times as high as wide, on black."""
    splats = ball()
    means = splats.means * np.array([1.0, 4.0, 1.0], np.float32)
    stream = encode_splats(replace(splats, means=means, sh=np.abs(splats.sh) + 1), SMALL, quality=Quality(10.0))
    packed = tmp_path_factory.mktemp("visitors") / "tall.html"
    packed.write_bytes(pack_stream(stream, "a tower"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> str:
    stream, _ = encode_sequence(moving_frames(300, 6), SequenceOptions(Fraction(8), 3))
    packed = tmp_path_factory.mktemp("visitors") / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    return packed.as_uri()


def opened(page: Browser, url: str) -> None:
    page.open("about:blank")
    page.open(url)
    page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view")


def axe_findings(page: Browser) -> list[str]:
    """Findings of axe in the page, including shadow trees and best practices."""
    page.evaluate((WEB / "node_modules" / "axe-core" / "axe.min.js").read_text() + "; 0")
    return json.loads(
        page.resolve(
            "axe.run().then(({violations}) => JSON.stringify(violations.map(({id, nodes}) => "
            "`${id}: ${nodes.map(({html}) => html.slice(0, 80)).join()}`)))"
        )
    )


def test_axe_finds_no_accessibility_problem(scene: str, clip: str) -> None:
    if reason := lacking():
        pytest.skip(reason)
    with isolated_page() as page:
        for url in (scene, clip):
            opened(page, url)
            for width, height, touch, scheme in (*((*window, "light") for window in WINDOWS), (*WINDOWS[0], "dark")):
                page.emulate(width, height, touch=touch, prefers_color_scheme=scheme)
                for is_open in (False, True):
                    page.evaluate(f"{ELEMENT}.controlPanel.open = {json.dumps(is_open)}")
                    assert axe_findings(page) == [], (url, width, scheme, is_open)


def test_images_have_names_and_touch_targets_are_large(scene: str, clip: str) -> None:
    small = (
        f"[...{ROOT}.querySelectorAll('button, select, input[type=range], fieldset label')]"
        ".filter((one) => one.getClientRects().length)"
        f".map((one) => [one.textContent, one.getBoundingClientRect().height]).filter(([, side]) => side < {SMALLEST})"
    )
    with isolated_page() as page:
        page.emulate(390, 844, touch=True)
        for url, title in ((scene, "a ball"), (clip, "a clip")):
            opened(page, url)
            canvases = f"[...{ROOT}.querySelectorAll('.scene canvas')].map((one) => [one.role, one.ariaLabel])"
            assert page.evaluate(canvases) == [["img", f"Picture of {title}"]] * 2
            page.evaluate(f"{ELEMENT}.controlPanel.open = true")
            assert page.evaluate(small) == []
            cut = f"[...{ROOT}.querySelectorAll('button')].filter((one) => one.scrollWidth > one.offsetWidth).length"
            assert page.evaluate(cut) == 0, "a word is wider than its button"
            page.evaluate(f"{ELEMENT}.controlPanel.showHelp(true)")
            assert page.evaluate(small) == []
            assert axe_findings(page) == []


def test_keyboard_focus_of_the_scene_is_visible(scene: str) -> None:
    ring = f"getComputedStyle({ROOT}.querySelector('.scene'), '::after').borderTopWidth"
    with isolated_page() as page:
        opened(page, scene)
        before = page.screenshot()
        page.evaluate(f"{ROOT}.querySelector('.scene').focus({{focusVisible: true}})")
        assert page.evaluate(ring) == "3px"
        assert page.screenshot() != before


def test_a_scene_fits_the_free_part_of_the_window(tall: str) -> None:
    """The scene is completely visible and as large as possible, also with the laboratory open."""
    with isolated_page() as page:
        for width, height, touch in WINDOWS:
            page.emulate(width, height, touch=touch)
            opened(page, tall)
            page.evaluate(f"{ROOT}.querySelector('.foot').style.display = 'none'")  # it lies on the scene
            for laboratory in (False, True):
                page.evaluate(f"{ELEMENT}.controlPanel.open = {str(laboratory).lower()}")
                for _ in range(20):  # the screen may show a picture of the earlier size for some frames
                    if (share := free_part(page)) > 0.75:
                        break
                assert share > 0.75, f"{share:.2f} of {width} x {height}"


def free_part(page: Browser) -> float:
    """Returns the share of the free part's height or width that the scene takes, the larger; 0 if it is cut off."""
    page.resolve("new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))")
    page.resolve(f"{ELEMENT}.view.sorted()")
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(page.screenshot()))).convert("RGB"))
    box = page.evaluate(f"{ROOT}.querySelector('.scene').getBoundingClientRect().toJSON()")
    seen = picture[: int(box["bottom"]) - 4, : int(box["right"])].sum(axis=2) > 60
    if not seen.any() or seen[[0, -1]].any() or seen[:, [0, -1]].any():
        return 0.0
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    return float(max((rows[-1] - rows[0]) / seen.shape[0], (columns[-1] - columns[0]) / seen.shape[1]))


def test_unchanged_page_requests_no_frames(scene: str) -> None:
    """Some seconds after its last picture a page requests no frames until the next user input."""
    count = """(() => {
      window.frames_ = 0; const plain = requestAnimationFrame;
      window.requestAnimationFrame = (work) => plain((at) => { window.frames_++; work(at); });
      window.drawn_ = 0;
      for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
        const draw = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...given) { window.drawn_++; draw.apply(this, given); };
      }
      return true;
    })()"""
    pause = "new Promise((resolve) => setTimeout(resolve, {}))"
    with isolated_page() as page:
        opened(page, scene)
        page.evaluate(count)
        for _ in range(120):  # the last picture may be late on a busy machine
            page.evaluate("window.frames_ = window.drawn_ = 0")
            page.resolve(pause.format(1000))
            if (seen := page.evaluate("[window.frames_, window.drawn_]")) == [0, 0]:
                break
        assert seen == [0, 0]
        page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
        page.key("ArrowLeft")
        page.wait_for("window.drawn_ > 0")


def test_double_click_sets_the_orbit_target(scene: str) -> None:
    orbit = f"{ELEMENT}.view.orbit"
    target = f"[{orbit}.target.x, {orbit}.target.y, {orbit}.target.z]"
    with isolated_page() as page:
        page.emulate(800, 600)
        opened(page, scene)
        before = page.evaluate(f"[{orbit}.distance, ...{target}]")
        page.double_click(480, 250)
        page.wait_for(f"{orbit}.distance < {0.9 * before[0]}")
        assert np.abs(np.subtract(page.evaluate(target), before[1:])).max() > 0.1
        page.key("Home")
        page.wait_for(f"String([{orbit}.distance, ...{target}]) === '{','.join(map(str, before))}'")


def test_closed_settings_panel_does_not_cover_the_scene(scene: str) -> None:
    """Only a bar at the bottom covers the scene; one button opens and closes the laboratory."""
    tops = f"[...{ROOT}.querySelectorAll('.panel > *')].filter((one) => one.getClientRects().length && \
getComputedStyle(one).visibility === 'visible').map((one) => one.getBoundingClientRect().top)"
    button = f"{ROOT}.querySelector('[aria-controls=laboratory]')"
    with isolated_page() as page:
        for width, height, touch in WINDOWS:
            page.emulate(width, height, touch=touch)
            opened(page, scene)
            assert min(page.evaluate(tops)) > height - 64
            assert "a ball" in page.evaluate(f"{ROOT}.querySelector('.bar').innerText")
            page.evaluate(f"{button}.click()")
            assert page.evaluate(f"{button}.ariaExpanded") == "true"
            assert "Concealer" in page.evaluate(f"{ROOT}.querySelector('.laboratory').innerText")
            page.evaluate(f"{button}.click()")
            assert page.evaluate(f"{button}.ariaExpanded") == "false"
            assert min(page.evaluate(tops)) > height - 64


@contextlib.asynccontextmanager
async def below_a_path(port: int) -> AsyncIterator[str]:
    """Offers a page server below a path, as a proxy that removes this path from requests; yields the address."""

    async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readuntil(b"\r\n\r\n")
        _, path, _ = head.split(b" ", 2)
        if path.startswith(b"/splats/"):
            inner, further = await asyncio.open_connection("127.0.0.1", port)
            with contextlib.closing(further):
                further.write(head.replace(b" /splats/", b" /", 1))
                writer.write(await inner.read())
        else:
            writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
        await writer.drain()
        writer.close()

    async with listening(forward) as own_port:
        yield f"http://127.0.0.1:{own_port}/splats/"


def test_several_scenes_are_listed_with_their_previews(tmp_path: Path) -> None:
    """Served and packed pages have a link per scene, mark the shown one, and include a preview if available."""
    if reason := lacking():
        pytest.skip(reason)
    bundled = read_stream(ASSETS / SPLATS)[0]
    streams = {"a ball": encode_splats(ball(), SMALL, quality=Quality(10.0)), "bundled": bundled}
    packed = tmp_path / "both.html"
    packed.write_bytes(pack_streams(streams))
    content = PageContent({name: prepare_served_stream(stream, Protection()) for name, stream in streams.items()})
    links = "[...document.querySelectorAll('nav a')].map((one) => [one.textContent, one.ariaCurrent ?? ''])"
    drawn = "(() => { const {width, height} = document.querySelector('splat-wire-preview canvas'), \
data = document.querySelector('splat-wire-preview canvas').getContext('2d').getImageData(0, 0, width, height).data; \
return new Set(data).size })()"

    def drive(urls: list[str]) -> None:
        with isolated_page() as page:
            page.emulate(390, 844, touch=True)
            for url in urls:
                opened(page, url)
                assert page.evaluate(links) == [["a ball", "page"], ["bundled", ""]]
                assert page.evaluate("document.querySelectorAll('splat-wire-preview').length") == 1
                assert page.evaluate(drawn) > 50, "no picture"
                assert axe_findings(page) == []
                assert page.evaluate("document.querySelector('nav').getBoundingClientRect().bottom") < 64
                page.evaluate("document.querySelectorAll('nav a')[1].click()")
                page.wait_for(f"{ELEMENT}?.status?.expected === {len(bundled.packets)}")
                assert page.evaluate(links) == [["a ball", ""], ["bundled", "page"]]
                assert "bundled" in page.evaluate(f"{ROOT}.querySelector('.title').textContent")
                opened(page, page.evaluate(f"{ELEMENT}.link()"))
                assert page.evaluate(links) == [["a ball", ""], ["bundled", "page"]], "the link is to another scene"

    async def work() -> None:
        async with PageServer(content) as server, below_a_path(server.port) as proxied:
            await asyncio.to_thread(drive, [packed.as_uri(), server.url, proxied])

    run(work())


def test_view_opens_the_laboratory_with_its_status() -> None:
    stream = encode_splats(ball(300), SMALL, quality=Quality(10.0))
    page = page_of_stream("a ball", stream, None, "127.0.0.1").respond_now(b"GET / HTTP/1.1\r\nHost: 127.0.0.1").body
    assert b'panel="open"' in page
    assert b'src="streams/a%20ball.swz' in page, "the title is what the file is called"


def test_reduced_motion_preference_pauses_a_clip(clip: str) -> None:
    button = f"{ROOT}.querySelector('.player button').textContent"
    with isolated_page() as page:
        for preferred, words in (("reduce", "play"), ("no-preference", "pause")):
            page.emulate(800, 600, prefers_reduced_motion=preferred)
            opened(page, clip)
            assert page.evaluate(button) == words
