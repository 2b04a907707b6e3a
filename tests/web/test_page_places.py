"""The element wherever a page puts it: hidden, without height, transformed, in a frame, on a page that scrolls."""

import asyncio
import json
from collections.abc import Callable

import pytest

from codec.gaussians.test_gaussians import some_splats
from explicit import encode_splats
from scenes import tiny_cameras, tiny_causal_scene
from splatwire.codec import encode_scene
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.levels import encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization, stream_to_bytes
from transport.chromium import Browser, browser, executable
from web.host import Host, hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
SCRIPT = '<script type="module" src="splatwire.js"></script><style>body {{ margin: 0; }}</style>'
SIZE = "width: 400px; height: 300px"
ONE = f'{SCRIPT}<splat-wire src="{{src}}" panel="none" {{more}} style="{{style}}"></splat-wire>'
PAGES = {
    "none": ONE.format(src="levels.swz", more="", style=f"{SIZE}; display: none"),
    "anchors": f'{SCRIPT}<splat-wire src="anchors.swz" style="{SIZE}"></splat-wire>'.format(),
    "zero": ONE.format(src="levels.swz", more="", style="width: 0; height: 0; min-height: 0"),
    "plain": ONE.format(src="ball.swz", more="", style=SIZE),
    "turned": ONE.format(
        src="ball.swz", more="", style=f"{SIZE}; position: absolute; left: 100px; top: 50px; rotate: 90deg; scale: 0.5"
    ),
    "flat": f'<div style="perspective: 600px; position: absolute; left: 40px; top: 40px">'
    f"{ONE.format(src='ball.swz', more='', style=f'{SIZE}; transform: rotateY(50deg)')}</div>",
    "long": ONE.format(src="ball.swz", more='gestures="cooperative"', style=SIZE) + '<p style="height: 300vh"></p>',
    "frame": ONE.format(src="ball.swz", more="", style=SIZE) + '<iframe style="width: 500px; height: 400px"></iframe>',
}
COLOURS = f"""(async () => {{
  const {{ view }} = {ELEMENT};
  await view.sorted();
  await view.frame();
  const copy = new OffscreenCanvas(view.canvas.width, view.canvas.height), context = copy.getContext("2d");
  context.drawImage(view.canvas, 0, 0);
  const {{ data }} = context.getImageData(0, 0, copy.width, copy.height);
  return new Set(Array.from({{ length: data.length / 4 }}, (_, n) => data.subarray(4 * n, 4 * n + 3).join())).size;
}})()"""
"""How many colours the picture has; that of an empty one is 1."""
SPIED = f"""(() => {{
  const {{ orbit }} = {ELEMENT}.view;
  window.places = [];
  orbit.focus = (at) => places.push(at);
}})()"""
LOOK = f"(({{ yaw, pitch, distance }}) => [yaw, pitch, distance].join())({ELEMENT}.view.orbit)"


@pytest.fixture(scope="module")
def streams() -> dict[str, bytes]:
    plain = encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))
    levels = encode_levels(SplatScene(some_splats(6000)), Packetization(block_size=400, lanes=2))
    anchors = encode_scene(tiny_causal_scene(seed=7, num_anchors=200), Packetization(block_size=200, lanes=1))
    scenes = {"ball.swz": plain, "levels.swz": levels, "anchors.swz": anchors}
    return {name: stream_to_bytes(stream) for name, stream in scenes.items()}


def driven(streams: dict[str, bytes], work: Callable[[Host, Browser], None]) -> None:
    async def serve() -> None:
        async with hosting(PAGES, streams) as host:

            def drive() -> None:
                with browser() as page:
                    work(host, page)

            await asyncio.to_thread(drive)

    run(serve())


def opened(page: Browser, url: str) -> None:
    page.open(url)
    page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view", 60)


@pytest.mark.parametrize("name", ["none", "zero"])
def test_levels_without_a_viewpoint_are_drawn_once_the_element_is_shown(streams: dict[str, bytes], name: str) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}{name}")
        page.wait_for(f"{ELEMENT}?.status?.expected > 0", 60)
        assert page.evaluate(f"{ELEMENT}.view") is None
        page.evaluate(f"{ELEMENT}.style.cssText = '{SIZE}'")
        page.wait_for(f"{ELEMENT}.status.gaussians > 0 && {ELEMENT}.view", 60)
        assert page.evaluate(f"{ELEMENT}.view.camera.viewmat.flat().every(Number.isFinite)")
        assert page.resolve(COLOURS) > 100

    driven(streams, work)


def test_an_element_that_had_no_height_for_a_while_has_its_picture_back_at_once(streams: dict[str, bytes]) -> None:
    sizes = f"new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(() => resolve([\
{ELEMENT}.view.canvas.width, {ELEMENT}.view.canvas.height].join()))))"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}plain")
        before, look = page.resolve(sizes), page.evaluate(LOOK)
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 400px; height: 0; min-height: 0'")
        page.resolve("new Promise((resolve) => setTimeout(resolve, 300))")
        page.resolve(f"{ELEMENT}.view.frame()")
        assert page.resolve(sizes) == before, "a picture without height would be stretched at first"
        page.evaluate(f"{ELEMENT}.style.cssText = '{SIZE}'")
        assert page.resolve(sizes) == before
        assert page.evaluate(LOOK) == look

    driven(streams, work)


def test_a_picture_from_a_camera_has_its_gaussians_where_the_element_has_no_height(streams: dict[str, bytes]) -> None:
    cameras = tiny_cameras(1, 240, 180)
    camera = {"viewmat": cameras.viewmats[0].tolist(), "focal": float(cameras.Ks[0, 1, 1]), "width": 240, "height": 180}
    picture = f"{ELEMENT}.picture({json.dumps(camera)})"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}anchors")
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 400px; height: 0; min-height: 0'")
        page.wait_for(f"{ELEMENT}.view.canvas.clientHeight === 0")
        flat = page.resolve(picture)
        page.evaluate(f"{ELEMENT}.view.fix(null); {ELEMENT}.style.cssText = '{SIZE}'")
        page.wait_for(f"{ELEMENT}.view.canvas.clientHeight > 0")
        assert page.resolve(picture) == flat

    driven(streams, work)


def test_a_long_message_leaves_the_scene_half_of_a_small_element(streams: dict[str, bytes]) -> None:
    canvas = f"{ELEMENT}.view.canvas"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}anchors")
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 240px; height: 180px'")
        page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.state').className = 'state bad'")
        page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.state').textContent = 'damaged packets '.repeat(40)")
        page.resolve("new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))")
        assert page.evaluate(f"{canvas}.clientHeight") >= 90

    driven(streams, work)


@pytest.mark.parametrize("name", ["plain", "turned", "flat"])
def test_what_is_pointed_at_is_found_in_a_transformed_element(streams: dict[str, bytes], name: str) -> None:
    """A marker at a place of the element says where the browser shows that."""
    mark = f"""(() => {{
      const dot = document.createElement("i");
      dot.style.cssText = "position: absolute; left: 300px; top: 60px; width: 0; height: 0";
      {ELEMENT}.shadowRoot.querySelector(".scene").append(dot);
      const {{ x, y }} = dot.getBoundingClientRect();
      return [x, y];
    }})()"""

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}{name}")
        page.evaluate(SPIED)
        page.double_click(*page.evaluate(mark))
        place = page.wait_for("places.length && places[0]")
        assert abs(place["x"] - 300) < 3, place
        assert abs(place["y"] - 60) < 3, place

    driven(streams, work)


def test_the_wheel_and_one_finger_scroll_a_page_that_asks_for_it(streams: dict[str, bytes]) -> None:
    hint = f"{ELEMENT}.shadowRoot.querySelector('.hint').textContent"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}long")
        look = page.evaluate(LOOK)
        page.wheel(200, 150, 100)
        page.wait_for("scrollY > 0")
        assert "wheel" in page.wait_for(hint)
        assert page.evaluate(LOOK) == look
        page.evaluate("scrollTo(0, 0)")
        page.touch([(200, 150)], [(240, 130)])
        assert page.evaluate(LOOK) == look
        page.touch([(150, 150), (250, 150)], [(140, 150), (260, 150)], [(100, 150), (300, 150)])
        page.wait_for(f"{LOOK} !== '{look}'")
        look = page.evaluate(LOOK)
        page.evaluate(f"{ELEMENT}.gestures = ''; scrollTo(0, 0)")
        page.wheel(200, 150, 100)
        page.wait_for(f"{LOOK} !== '{look}'")
        assert page.evaluate("scrollY") == 0

    driven(streams, work)


def test_an_element_that_moves_to_another_document_keeps_its_looks_and_goes_on(streams: dict[str, bytes]) -> None:
    bar = "getComputedStyle(moved.shadowRoot.querySelector('.bar')).display"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}frame")
        page.evaluate(f"window.moved = {ELEMENT}; moved.setAttribute('panel', 'open')")
        assert page.evaluate(bar) == "flex"
        page.evaluate(
            "document.querySelector('iframe').contentDocument.body.append(moved); window.began = moved.status"
        )
        assert page.evaluate(bar) == "flex"
        page.resolve("moved.view.frame()")
        page.evaluate("document.body.append(moved)")
        assert page.evaluate(bar) == "flex"
        page.resolve("moved.view.frame()")
        assert page.evaluate("moved.status === began && moved.status.verified"), "it began anew"

    driven(streams, work)
