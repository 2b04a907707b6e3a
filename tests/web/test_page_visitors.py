"""What visitors meet: a page in which axe finds nothing, a bar that leaves the scene free, nothing moves unasked."""

import asyncio
import base64
import io
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from explicit import encode_splats
from moving_clips import moving_frames
from splatwire.cli._bundled import ASSETS, SPLATS
from splatwire.cli.serve import program_of
from splatwire.clips import ClipOptions, encode_clip
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.packets import read_stream
from splatwire.transport import Protection
from splatwire.transport.pack import pack_stream, pack_streams
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import PageContent
from splatwire.view.page import page_of_stream
from transport.chromium import Browser, browser, executable
from web.node import WEB, lacking
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
ROOT = f"{ELEMENT}.shadowRoot"
WINDOWS = ((1280, 800, False), (390, 844, True))
SMALLEST = 44
"""Pixels of what a finger has to hit."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> str:
    stream = encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))
    packed = tmp_path_factory.mktemp("visitors") / "ball.html"
    packed.write_bytes(pack_stream(stream, "a ball"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def tall(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene four times as high as it is wide, on black."""
    splats = ball()
    means = splats.means * np.array([1.0, 4.0, 1.0], np.float32)
    stream = encode_splats(replace(splats, means=means, sh=np.abs(splats.sh) + 1), SMALL, quality=Quality(10.0))
    packed = tmp_path_factory.mktemp("visitors") / "tall.html"
    packed.write_bytes(pack_stream(stream, "a tower"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> str:
    stream, _ = encode_clip(moving_frames(300, 6), ClipOptions(Fraction(8), 3))
    packed = tmp_path_factory.mktemp("visitors") / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    return packed.as_uri()


def opened(page: Browser, url: str) -> None:
    page.open("about:blank")
    page.open(url)
    page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view", 60)


def found_by_axe(page: Browser) -> list[str]:
    """What axe objects to in the page, shadow trees and best practices included."""
    page.evaluate((WEB / "node_modules" / "axe-core" / "axe.min.js").read_text() + "; 0")
    return json.loads(
        page.resolve(
            "axe.run().then(({violations}) => JSON.stringify(violations.map(({id, nodes}) => "
            "`${id}: ${nodes.map(({html}) => html.slice(0, 80)).join()}`)))"
        )
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(scene: str, clip: str, scheme: str) -> None:
    if reason := lacking():
        pytest.skip(reason)
    with browser() as page:
        for width, height, touch in WINDOWS:
            page.emulate(width, height, touch=touch, prefers_color_scheme=scheme)
            for url in (scene, clip):
                opened(page, url)
                assert found_by_axe(page) == []
                page.evaluate(f"{ELEMENT}.panel.open = true")
                assert found_by_axe(page) == []


def test_pictures_have_names_and_fingers_have_room(scene: str, clip: str) -> None:
    small = (
        f"[...{ROOT}.querySelectorAll('button, select, input[type=range], fieldset label')]"
        f".map((one) => [one.textContent, one.getBoundingClientRect().height]).filter(([, side]) => side < {SMALLEST})"
    )
    with browser() as page:
        page.emulate(390, 844, touch=True)
        for url, title in ((scene, "a ball"), (clip, "a clip")):
            opened(page, url)
            canvases = f"[...{ROOT}.querySelectorAll('.scene canvas')].map((one) => [one.role, one.ariaLabel])"
            assert page.evaluate(canvases) == [["img", f"Picture of {title}"]] * 2
            page.evaluate(f"{ELEMENT}.panel.open = true")
            assert page.evaluate(small) == []
            cut = f"[...{ROOT}.querySelectorAll('button')].filter((one) => one.scrollWidth > one.offsetWidth).length"
            assert page.evaluate(cut) == 0, "a word is wider than its button"


def test_the_focus_of_the_scene_is_seen(scene: str) -> None:
    ring = f"getComputedStyle({ROOT}.querySelector('.scene'), '::after').borderTopWidth"
    with browser() as page:
        opened(page, scene)
        before = page.screenshot()
        page.evaluate(f"{ROOT}.querySelector('.scene').focus({{focusVisible: true}})")
        assert page.evaluate(ring) == "3px"
        assert page.screenshot() != before


def test_a_scene_fits_the_free_part_of_the_window(tall: str) -> None:
    """All of it is seen, and as large as it can be; with the laboratory open, too."""
    with browser() as page:
        for width, height, touch in WINDOWS:
            page.emulate(width, height, touch=touch)
            opened(page, tall)
            for laboratory in (False, True):
                page.evaluate(f"{ELEMENT}.panel.open = {str(laboratory).lower()}")
                page.resolve("new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve, 100)))")
                page.resolve(f"{ELEMENT}.view.sorted()")
                picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(page.screenshot()))).convert("RGB"))
                box = page.evaluate(f"{ROOT}.querySelector('.scene').getBoundingClientRect().toJSON()")
                seen = picture[: int(box["bottom"]) - 4, : int(box["right"])].sum(axis=2) > 60
                rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
                assert min(rows[0], columns[0]) > 0
                assert not seen[-1].any()
                assert not seen[:, -1].any()
                share = max((rows[-1] - rows[0]) / seen.shape[0], (columns[-1] - columns[0]) / seen.shape[1])
                assert share > 0.75, f"{share:.2f} of {width} x {height}"


def test_nothing_is_drawn_where_nothing_changes(scene: str) -> None:
    """Some seconds after its last picture a page has no frames any more, until somebody moves."""
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
    with browser() as page:
        opened(page, scene)
        page.evaluate(count)
        for _ in range(30):  # the last picture of a busy machine is a late one
            page.evaluate("window.frames_ = window.drawn_ = 0")
            page.resolve(pause.format(1000))
            if (seen := page.evaluate("[window.frames_, window.drawn_]")) == [0, 0]:
                break
        assert seen == [0, 0]
        page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
        page.key("ArrowLeft")
        page.wait_for("window.drawn_ > 0", 20)


def test_what_is_clicked_twice_is_turned_around(scene: str) -> None:
    orbit = f"{ELEMENT}.view.orbit"
    target = f"[{orbit}.target.x, {orbit}.target.y, {orbit}.target.z]"
    with browser() as page:
        page.emulate(800, 600)
        opened(page, scene)
        before = page.evaluate(f"[{orbit}.distance, ...{target}]")
        page.double_click(480, 250)
        page.wait_for(f"{orbit}.distance < {0.9 * before[0]}", 20)
        assert np.abs(np.subtract(page.evaluate(target), before[1:])).max() > 0.1
        page.key("Home")
        page.wait_for(f"String([{orbit}.distance, ...{target}]) === '{','.join(map(str, before))}'", 20)


def test_the_closed_laboratory_leaves_the_scene_free(scene: str) -> None:
    """What lies on the scene is a bar at its foot; one button opens the laboratory and closes it again."""
    tops = f"[...{ROOT}.querySelectorAll('.panel > *')].filter((one) => one.getClientRects().length && \
getComputedStyle(one).visibility === 'visible').map((one) => one.getBoundingClientRect().top)"
    button = f"{ROOT}.querySelector('[aria-controls=laboratory]')"
    with browser() as page:
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


def test_several_scenes_are_listed_with_their_previews(tmp_path: Path) -> None:
    """Served and packed: a link for each, the one that is shown marked, a picture where there is a preview."""
    if reason := lacking():
        pytest.skip(reason)
    bundled = read_stream(ASSETS / SPLATS)[0]
    streams = {"a ball": encode_splats(ball(), SMALL, quality=Quality(10.0)), "bundled": bundled}
    packed = tmp_path / "both.html"
    packed.write_bytes(pack_streams(streams))
    content = PageContent({name: program_of(stream, Protection()) for name, stream in streams.items()})
    links = "[...document.querySelectorAll('nav a')].map((one) => [one.textContent, one.ariaCurrent ?? ''])"
    drawn = "(() => { const {width, height} = document.querySelector('splat-wire-preview canvas'), \
data = document.querySelector('splat-wire-preview canvas').getContext('2d').getImageData(0, 0, width, height).data; \
return new Set(data).size })()"

    def drive(urls: list[str]) -> None:
        with browser() as page:
            page.emulate(390, 844, touch=True)
            for url in urls:
                opened(page, url)
                assert page.evaluate(links) == [["a ball", "page"], ["bundled", ""]]
                assert page.evaluate("document.querySelectorAll('splat-wire-preview').length") == 1
                assert page.evaluate(drawn) > 50, "no picture"
                assert found_by_axe(page) == []
                assert page.evaluate("document.querySelector('nav').getBoundingClientRect().bottom") < 64
                page.evaluate("document.querySelectorAll('nav a')[1].click()")
                page.wait_for(f"{ELEMENT}?.status?.expected === {len(bundled.packets)}", 60)
                assert page.evaluate(links) == [["a ball", ""], ["bundled", "page"]]
                assert "bundled" in page.evaluate(f"{ROOT}.querySelector('.title').textContent")

    async def work() -> None:
        async with PageServer(content) as server:
            await asyncio.to_thread(drive, [packed.as_uri(), server.url])

    run(work())


def test_view_opens_the_laboratory_and_says_what_it_shows() -> None:
    stream = encode_splats(ball(300), SMALL, quality=Quality(10.0))
    page = page_of_stream("a ball", stream, None, "127.0.0.1").answer(b"GET / HTTP/1.1\r\nHost: 127.0.0.1").body
    assert b'panel="open"' in page
    assert b'src="/streams/a%20ball.swz' in page, "the title is what the file is called"


def test_who_wants_no_motion_gets_a_clip_that_waits(clip: str) -> None:
    button = f"{ROOT}.querySelector('.player button').textContent"
    with browser() as page:
        for preferred, words in (("reduce", "play"), ("no-preference", "pause")):
            page.emulate(800, 600, prefers_reduced_motion=preferred)
            opened(page, clip)
            assert page.evaluate(button) == words
