"""The element as a viewer: playback, views, notices, hotspots, help and automatic rotation."""

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from explicit import encode_splats
from moving_sequences import moving_frames
from splatwire.bitstream import Packetization
from splatwire.codec.gaussians.quality import Quality
from splatwire.lod import encode_levels
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.transport.http.pack import pack_stream
from splatwire.types import SplatScene
from transport.chromium import Browser, executable, isolated_page
from web.node import lacking
from web.pictures import ELEMENT
from web.test_page import SMALL, ball
from web.test_page_visitors import opened

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
ROOT = f"{ELEMENT}.shadowRoot"
NEXT_FRAMES = "new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))"
STATE = f"""(() => {{
  const {{ attributes, childElementCount, status, view }} = {ELEMENT};
  return JSON.stringify([
    location.href, [...attributes].map(({{ name, value }}) => `${{name}}=${{value}}`).sort(), childElementCount,
    status.verified, !!view && {ELEMENT}.saveView(), {ROOT}.querySelector(".help").hidden,
  ]);
}})()"""
RESTORED = f"""(() => {{
  {ELEMENT}.replaceChildren();
  for (const name of ["autorotate", "camera-limits", "poster", "viewpoint"]) {ELEMENT}.removeAttribute(name);
  {ELEMENT}.view?.orbit.reset();
}})()"""
RATE, FRAMES = 8, 6


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> str:
    if reason := lacking():
        pytest.skip(reason)
    packed = tmp_path_factory.mktemp("viewer") / "ball.html"
    packed.write_bytes(pack_stream(encode_splats(ball(), SMALL, quality=Quality(10.0)), "a ball"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> str:
    if reason := lacking():
        pytest.skip(reason)
    stream, _ = encode_sequence(moving_frames(300, FRAMES), SequenceOptions(Fraction(RATE), 3))
    packed = tmp_path_factory.mktemp("viewer") / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    return packed.as_uri()


@pytest.fixture(scope="module")
def shared(still: str) -> Iterator[tuple[Browser, str]]:
    """A page with the still scene, and its first state. Tests with pages of their own are the last of this module."""
    with isolated_page() as page:
        page.emulate(800, 600)
        opened(page, still)
        yield page, page.evaluate(STATE)


@pytest.fixture
def page(shared: tuple[Browser, str], still: str) -> Browser:
    """The shared page in its first state; it is opened again only if an earlier test left it in another one."""
    page, first = shared
    page.emulate(800, 600)
    page.evaluate(RESTORED)
    if page.evaluate(STATE) != first:
        opened(page, still)
    return page


def view_of(page: Browser) -> list[float]:
    return [float(number) for number in page.evaluate(f"{ELEMENT}.saveView()").split()]


def test_static_scene_has_no_duration_and_does_not_play(page: Browser) -> None:
    page.evaluate(f"{ELEMENT}.play(); {ELEMENT}.currentTime = 1")
    assert page.evaluate(f"[{ELEMENT}.duration, {ELEMENT}.currentTime, {ELEMENT}.paused]") == [0, 0, True]


@pytest.mark.parametrize("turned", [False, True])
def test_a_saved_view_and_a_link_restore_the_camera(page: Browser, still: str, turned: bool) -> None:
    page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
    for key in ("ArrowLeft", "ArrowUp", "+", *("f" if turned else "")):
        page.key(key)
    page.resolve(NEXT_FRAMES)
    matrix = f"JSON.stringify({ELEMENT}.view.camera.viewmat)"
    wanted, saved = json.loads(page.evaluate(matrix)), page.evaluate(f"{ELEMENT}.saveView()")
    link = page.evaluate(f"{ELEMENT}.link()")
    opened(page, link)
    assert np.allclose(json.loads(page.evaluate(matrix)), wanted, atol=1e-3)
    opened(page, still)
    assert not np.allclose(json.loads(page.evaluate(matrix)), wanted, atol=1e-3)
    page.evaluate(f"{ELEMENT}.viewpoint = '{saved}'")
    assert np.allclose(json.loads(page.evaluate(matrix)), wanted, atol=1e-3)


def test_a_failed_stream_shows_a_notice_whose_button_tries_again(page: Browser) -> None:
    notice = f"{ROOT}.querySelector('.notice')"
    assert page.evaluate(f"{notice}.hidden"), "there is a picture"
    page.evaluate(f"{ELEMENT}.removeAttribute('data')")
    page.wait_for(f"{notice}.className === 'notice error' && {notice}.textContent.includes('no src')")
    assert page.evaluate(f"{notice}.querySelector('button').getClientRects().length") == 1
    page.evaluate(f"{ELEMENT}.setAttribute('data', 'stream'); {notice}.querySelector('button').click()")
    page.wait_for(f"{ELEMENT}.status.verified && {notice}.hidden")


def test_hotspots_follow_their_point_and_hide_behind_the_camera(page: Browser) -> None:
    """The camera of the view is the reference for the positions."""
    page.evaluate(
        f"{ELEMENT}.insertAdjacentHTML('beforeend', "
        "'<b slot=hotspot id=seen data-position=\"0.1 0.2 0\">a</b><b slot=hotspot id=wrong data-position=x>b</b>')"
    )
    eye, target = np.split(np.array(view_of(page)[:6]), 2)
    behind = " ".join(map(str, eye + (eye - target)))
    hidden = f"<b slot=hotspot id=gone data-position='{behind}'></b>"
    page.evaluate(f"{ELEMENT}.insertAdjacentHTML('beforeend', `{hidden}`)")
    page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
    for _ in range(2):
        page.key("ArrowRight")
        page.resolve(NEXT_FRAMES)
        numbers = "({viewmat, focal, width, height}) => ({viewmat, focal, width, height})"
        camera = page.evaluate(f"({numbers})({ELEMENT}.view.camera)")
        x, y, z = (np.array(camera["viewmat"]) @ [0.1, 0.2, 0, 1])[:3]
        wanted = [camera["width"] / 2 + camera["focal"] * x / z, camera["height"] / 2 + camera["focal"] * y / z]
        box = page.evaluate("document.getElementById('seen').getBoundingClientRect().toJSON()")
        scale = page.evaluate(f"{ELEMENT}.clientWidth") / camera["width"]
        centre = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert np.allclose(centre, np.multiply(wanted, scale), atol=2), (centre, wanted)
        shown = "['seen', 'wrong', 'gone'].map((id) => getComputedStyle(document.getElementById(id)).visibility)"
        assert page.evaluate(shown) == ["visible", "hidden", "hidden"]


def test_automatic_rotation_turns_the_camera_and_stops(page: Browser) -> None:
    page.emulate(800, 600, prefers_reduced_motion="no-preference")
    before = view_of(page)
    page.evaluate(f"window.moved = 0; {ELEMENT}.addEventListener('camerachange', () => window.moved++)")
    page.evaluate(f"{ELEMENT}.autorotate = ''")
    page.wait_for("window.moved > 3")
    after = view_of(page)
    assert np.allclose(before[3:], after[3:]), "target and up axis stay"
    assert not np.allclose(before[:3], after[:3])
    button = f"{ROOT}.querySelector('[aria-pressed]')"
    assert page.evaluate(f"{button}.ariaPressed") == "true"
    page.evaluate(f"{button}.click()")
    page.resolve(NEXT_FRAMES)
    stopped = view_of(page)
    page.resolve(NEXT_FRAMES)
    assert view_of(page) == stopped
    assert page.evaluate(f"{ELEMENT}.autorotate") is None
    page.evaluate(f"{ELEMENT}.setAttribute('autorotate', 'false')")  # as React 18 writes it
    page.evaluate(f"{button}.click()")
    assert page.evaluate(f"{button}.ariaPressed") == "true"


def test_reduced_motion_preference_prevents_automatic_rotation(page: Browser) -> None:
    page.emulate(800, 600, prefers_reduced_motion="reduce")
    before = view_of(page)
    page.evaluate(f"{ELEMENT}.autorotate = '90'")
    page.resolve(NEXT_FRAMES)
    assert view_of(page) == before


def test_automatic_rotation_stops_while_reduced_motion_is_preferred(page: Browser) -> None:
    page.emulate(800, 600, prefers_reduced_motion="no-preference")
    page.evaluate(f"window.moved = 0; {ELEMENT}.addEventListener('camerachange', () => window.moved++)")
    page.evaluate(f"{ELEMENT}.autorotate = '90'")
    button = f"{ROOT}.querySelector('[aria-pressed]')"
    for _ in range(2):
        page.wait_for(f"window.moved > 3 && {button}.ariaPressed === 'true'")
        page.emulate(800, 600, prefers_reduced_motion="reduce")
        page.wait_for(f"{button}.ariaPressed === 'false'")
        page.resolve(NEXT_FRAMES)
        stopped = view_of(page)
        page.resolve(NEXT_FRAMES)
        assert view_of(page) == stopped
        page.evaluate("window.moved = 0")
        page.emulate(800, 600, prefers_reduced_motion="no-preference")


def test_help_opens_by_its_key_and_closes_by_escape(page: Browser) -> None:
    shown = f"!{ROOT}.querySelector('.help').hidden"
    page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
    page.key("?")
    page.wait_for(shown)
    page.key("Escape")
    page.wait_for(f"!({shown})")
    assert page.evaluate(f"{ROOT}.activeElement.title") == "help", "the focus returns to the button"


def test_controls_fade_without_input_and_return_with_the_pointer(page: Browser) -> None:
    idle = f"{ROOT}.querySelector('.whole').classList.contains('idle')"
    page.wait_for(idle)
    page.evaluate(f"{ELEMENT}.dispatchEvent(new PointerEvent('pointermove', {{bubbles: true}}))")
    assert not page.evaluate(idle)


def test_a_poster_is_visible_until_the_first_picture(page: Browser) -> None:
    dot = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="
    posters = f"{ROOT}.querySelectorAll('.poster').length"
    page.evaluate(f"{ELEMENT}.removeAttribute('data'); {ELEMENT}.poster = '{dot}'")
    page.wait_for(f"{ELEMENT}.status.failed && {posters} === 1")
    page.evaluate(f"{ELEMENT}.setAttribute('data', 'stream')")
    page.wait_for(f"{ELEMENT}.status.verified && {posters} === 0")


def orbit_of(view: list[float]) -> tuple[float, float]:
    """Distance of the eye from the target, and its angle from the up axis, degrees."""
    eye, target, up = np.split(np.array(view), 3)
    distance = float(np.linalg.norm(eye - target))
    return distance, float(np.degrees(np.arccos((eye - target) @ up / distance)))


def test_camera_limits_hold_for_the_visitor_and_for_the_first_view(page: Browser) -> None:
    page.evaluate(f"{ELEMENT}.cameraLimits = '2 3 60 80'; {ROOT}.querySelector('.scene').focus()")
    for key, distance in (("-", 3), ("+", 2)):
        for _ in range(20):
            page.key(key)
        assert orbit_of(view_of(page))[0] == pytest.approx(distance, rel=1e-4)
    for key, polar in (("ArrowUp", 80), ("ArrowDown", 60)):
        for _ in range(20):
            page.key(key)
        assert orbit_of(view_of(page))[1] == pytest.approx(polar, abs=0.01)
    page.key("Home")
    distance, polar = orbit_of(view_of(page))
    assert 2 <= distance <= 3 + 1e-4
    assert 60 - 0.01 <= polar <= 80 + 0.01


def test_the_camera_flies_to_a_view_and_input_stops_it(page: Browser) -> None:
    page.emulate(800, 600, prefers_reduced_motion="no-preference")
    began = view_of(page)
    goal = [0.3, -0.6, -3.5, 0.1, 0.0, 0.2, *began[6:]]
    text = " ".join(map(str, goal))
    assert page.resolve(f"{ELEMENT}.flyTo('{text}', 0.3)") is True
    assert np.allclose(view_of(page), goal, atol=1e-4)
    turned = [*goal[:6], *(-number for number in began[6:])]
    assert page.resolve(f"{ELEMENT}.flyTo('{' '.join(map(str, turned))}', 0)") is True
    assert np.allclose(view_of(page), turned, atol=1e-4)
    back = " ".join(map(str, began))
    page.evaluate(f"window.arrived = null; {ELEMENT}.flyTo('{back}', 60).then((is) => (window.arrived = is)); 0")
    page.resolve(NEXT_FRAMES)
    page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
    page.key("ArrowLeft")
    page.wait_for("window.arrived === false")
    assert "nine numbers" in page.resolve(f"{ELEMENT}.flyTo('1 2 3').catch(({{message}}) => message)")


def test_a_clip_is_played_paused_and_sought_from_a_program(clip: str) -> None:
    with isolated_page() as page:
        opened(page, clip)
        assert page.evaluate(f"{ELEMENT}.duration") == FRAMES / RATE
        page.evaluate(f"{ELEMENT}.pause()")
        assert page.evaluate(f"{ELEMENT}.paused")
        page.evaluate(f"{ELEMENT}.currentTime = 4 / {RATE}")
        page.wait_for(f"{ROOT}.querySelector('.player output').textContent === 'frame 5 of {FRAMES}'")
        assert page.evaluate(f"{ELEMENT}.currentTime") == 4 / RATE
        error = page.evaluate(f"(() => {{ try {{ {ELEMENT}.currentTime = NaN }} catch (e) {{ return e.name }} }})()")
        assert (error, page.evaluate(f"{ELEMENT}.currentTime")) == ("TypeError", 4 / RATE)
        page.evaluate(f"{ELEMENT}.play()")
        page.wait_for(f"!{ELEMENT}.paused && {ELEMENT}.currentTime !== 4 / {RATE}")
        page.evaluate(f"{ROOT}.querySelector('.scene').focus()")
        page.key(" ")
        page.wait_for(f"{ELEMENT}.paused")


def test_a_budget_of_gaussians_limits_what_is_drawn_of_levels(tmp_path: Path) -> None:
    if reason := lacking():
        pytest.skip(reason)
    scene, packed = SplatScene(ball(20_000)), tmp_path / "levels.html"
    packed.write_bytes(pack_stream(encode_levels(scene, Packetization(block_size=500, lanes=2)), "levels"))
    with isolated_page() as page:
        opened(page, packed.as_uri())
        page.wait_for(f"{ELEMENT}.status.gaussians > 4000")
        page.evaluate(f"{ELEMENT}.maxGaussians = 3000")
        page.wait_for(f"{ELEMENT}.status.gaussians > 0 && {ELEMENT}.status.gaussians <= 3000")
        page.evaluate(f"{ELEMENT}.removeAttribute('max-gaussians')")
        page.wait_for(f"{ELEMENT}.status.gaussians > 4000")
