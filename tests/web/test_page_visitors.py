"""What visitors meet: a page in which axe finds nothing, a bar that leaves the scene free, nothing moves unasked."""

import json
from fractions import Fraction

import pytest

from explicit import encode_splats
from moving_clips import moving_frames
from splatwire.clips import ClipOptions, encode_clip
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.transport.pack import pack_stream
from splatwire.view.page import page_of_stream
from transport.chromium import Browser, browser, executable
from web.node import WEB, lacking
from web.pictures import ELEMENT
from web.test_page import SMALL, ball

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


def test_the_focus_of_the_scene_is_seen(scene: str) -> None:
    ring = f"getComputedStyle({ROOT}.querySelector('.scene'), '::after').borderTopWidth"
    with browser() as page:
        opened(page, scene)
        before = page.screenshot()
        page.evaluate(f"{ROOT}.querySelector('.scene').focus({{focusVisible: true}})")
        assert page.evaluate(ring) == "3px"
        assert page.screenshot() != before


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


def test_view_opens_the_laboratory() -> None:
    stream = encode_splats(ball(300), SMALL, quality=Quality(10.0))
    head_and_body = page_of_stream(stream, None, "127.0.0.1").answer(b"GET / HTTP/1.1\r\nHost: 127.0.0.1")
    assert b'panel="open"' in head_and_body[1]


def test_who_wants_no_motion_gets_a_clip_that_waits(clip: str) -> None:
    button = f"{ROOT}.querySelector('.player button').textContent"
    with browser() as page:
        for preferred, words in (("reduce", "play"), ("no-preference", "pause")):
            page.emulate(800, 600, prefers_reduced_motion=preferred)
            opened(page, clip)
            assert page.evaluate(button) == words
