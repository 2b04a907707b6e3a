"""The element anywhere on a page: hidden, without height, transformed, in a frame, on a scrolling page."""

import asyncio
import base64
import json
from collections.abc import Callable

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from explicit import encode_splats
from scenes import tiny_cameras, tiny_causal_scene
from splatwire.bitstream import Packetization, stream_to_bytes
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.preview import MAX_LEVELS, Preview, PreviewQuantisation, write_preview
from splatwire.lod import encode_levels
from splatwire.types import SplatScene
from transport.chromium import Browser, executable, isolated_page
from web.host import Host, hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
SCRIPT = '<script type="module" src="splatwire.js"></script><style>body {{ margin: 0; }}</style>'
SIZE = "width: 400px; height: 300px"
ONE = f'{SCRIPT}<splat-wire src="{{src}}" panel="none" {{more}} style="{{style}}"></splat-wire>'
GET = "const get = HTMLCanvasElement.prototype.getContext; HTMLCanvasElement.prototype.getContext ="
WITHOUT_2D = f"<script>{{ {GET} function (kind, ...more) {{ \
return kind === '2d' && this.className.includes('first') ? null : get.call(this, kind, ...more); }}; }}</script>"
WITHOUT_MEMORY = """<script>{ const make = URL.createObjectURL; URL.createObjectURL = (blob) => make(new Blob([
`const say = self.postMessage; self.postMessage = (message, ...more) => {
  if (message.kind === "splats") throw new RangeError("no memory"); say.call(self, message, ...more); };`, blob])); }
</script>"""
HELD = """<script>{
  const listen = EventTarget.prototype.addEventListener, go = new Promise((resolve) => (window.go = resolve));
  Worker.prototype.addEventListener = function (kind, handler) {
    listen.call(this, kind, (event) => void go.then(() => handler.call(this, event)));
  };
}</script>"""
"""Page that delays the worker's messages until `go()` is called."""
PAGES = {
    "none": ONE.format(src="levels.swz", more="", style=f"{SIZE}; display: none"),
    "anchors": f'{SCRIPT}<splat-wire src="anchors.swz" style="{SIZE}"></splat-wire>'.format(),
    "zero": ONE.format(src="levels.swz", more="", style="width: 0; height: 0; min-height: 0"),
    "plain": ONE.format(src="ball.swz", more="", style=SIZE),
    "nowhere": ONE.format(src="ball.swz", more='viewpoint="0 0 0 0 0 0 0 0 0"', style=SIZE),
    "without-2d": WITHOUT_2D + ONE.format(src="ball.swz", more="", style=SIZE),
    "without-memory": WITHOUT_MEMORY + ONE.format(src="ball.swz", more="", style=SIZE),
    "turned": ONE.format(
        src="ball.swz", more="", style=f"{SIZE}; position: absolute; left: 100px; top: 50px; rotate: 90deg; scale: 0.5"
    ),
    "flat": f'<div style="perspective: 600px; position: absolute; left: 40px; top: 40px">'
    f"{ONE.format(src='ball.swz', more='', style=f'{SIZE}; transform: rotateY(50deg)')}</div>",
    "zoomed": f'<div style="zoom: 0.75">{ONE.format(src="ball.swz", more="", style=f"{SIZE}; zoom: 2")}</div>',
    "long": ONE.format(src="ball.swz", more='gestures="cooperative"', style=SIZE) + '<p style="height: 300vh"></p>',
    "frame": ONE.format(src="ball.swz", more="", style=SIZE) + '<iframe style="width: 500px; height: 400px"></iframe>',
}
COLOURS = f"""(async () => {{
  const {{ view }} = {ELEMENT};
  for (;;) {{
    await view.sorted();
    await view.frame();
    const copy = new OffscreenCanvas(view.canvas.width, view.canvas.height), context = copy.getContext("2d");
    context.drawImage(view.canvas, 0, 0);
    const {{ data }} = context.getImageData(0, 0, copy.width, copy.height);
    const found = Array.from({{ length: data.length / 4 }}, (_, n) => data.subarray(4 * n, 4 * n + 3).join());
    if (new Set(found).size > 100) return true;
  }}
}})()"""
"""Resolves once the picture has more than 100 colours; an empty one has 1."""
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


def driven(
    streams: dict[str, bytes], work: Callable[[Host, Browser], None], pages: dict[str, str] | None = None
) -> None:
    async def serve() -> None:
        async with hosting(PAGES | (pages or {}), streams) as host:

            def drive() -> None:
                with isolated_page() as page:
                    work(host, page)

            await asyncio.to_thread(drive)

    run(serve())


def opened(page: Browser, url: str) -> None:
    page.open(url)
    page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view")


@pytest.mark.parametrize("name", ["none", "zero"])
def test_levels_without_a_viewpoint_render_once_visible(streams: dict[str, bytes], name: str) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}{name}")
        page.wait_for(f"{ELEMENT}?.status?.expected > 0")
        assert page.evaluate(f"{ELEMENT}.status.gaussians") == 0
        page.evaluate(f"{ELEMENT}.style.cssText = '{SIZE}'")
        page.wait_for(f"{ELEMENT}.status.gaussians > 0 && {ELEMENT}.view")
        assert page.evaluate(f"{ELEMENT}.view.camera.viewmat.flat().every(Number.isFinite)")
        assert page.resolve(COLOURS)

    driven(streams, work)


def test_renderer_that_a_busy_server_refused_is_requested_again(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        host.busy["splatwire-view.js"] = 2
        opened(page, f"{host.url}plain")
        assert host.busy["splatwire-view.js"] == 0
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    driven(streams, work)


def test_scene_appears_without_a_canvas_for_the_first_pictures(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}without-2d")
        page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view")
        assert page.resolve(COLOURS)
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    driven(streams, work)


def test_viewpoints_that_show_nothing_are_ignored(streams: dict[str, bytes]) -> None:
    """A viewpoint without a direction is refused; one that shows nothing is replaced by the default."""

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}nowhere")
        assert page.resolve(COLOURS)
        page.evaluate(f"window.home = {ELEMENT}.saveView()")
        for wrong in ("1e14 0 0 0 0 0 0 1 0", "1e30 0 0 0 0 0 0 1 0", "1 2 3 1 2 3 0 1 0"):
            page.evaluate(f"{ELEMENT}.setAttribute('viewpoint', '{wrong}')")
            assert page.resolve(COLOURS), wrong
        assert page.resolve(f"{ELEMENT}.flyTo('1e14 0 0 0 0 0 0 1 0', 0)")
        assert page.resolve(f"{ELEMENT}.flyTo(home, 0)")
        assert page.resolve(COLOURS)
        page.evaluate(f"{ELEMENT}.view.orbit.flip()")
        page.evaluate(f"{ELEMENT}.setAttribute('viewpoint', home)")
        assert page.evaluate(
            f"(({ELEMENT}.saveView().split(' ').map(Number)).every((n, i) => \
            Math.abs(n - home.split(' ')[i]) < 1e-3))"
        )
        assert page.resolve(COLOURS)

    driven(streams, work)


def test_preview_and_poster_with_a_viewpoint_show_and_keep_that_viewpoint(streams: dict[str, bytes]) -> None:
    """The messages of the worker wait until the preview was examined, so that no state depends on time."""
    dot = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="
    rows = np.random.default_rng(1).integers(0, 1 + np.array(MAX_LEVELS), (90, len(MAX_LEVELS)))
    frame = PreviewQuantisation.fitting((0.0, 0.0, 0.0), 1.0, [-1.2, -1.2, -1.2, -2.5], [1.2, 1.2, 1.2, -1.0])
    preview = base64.b64encode(write_preview(Preview(frame, (0, 0, 0), rows))).decode()
    first, second = ([x, 0.5, 4.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0] for x in (2.0, -2.0))
    words = [" ".join(map(str, view)) for view in (first, second)]
    more = f'viewpoint="{words[0]}" poster="{dot}" preview="{preview}"'
    root = f"{ELEMENT}.shadowRoot"
    painted, posters = f"{root}.querySelector('canvas.first').toDataURL()", f"{root}.querySelectorAll('.poster').length"
    saved = f"{ELEMENT}.saveView().split(' ').map(Number)"

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}preview")
        page.wait_for(f"{ELEMENT}?.status?.times?.preview > 0")
        assert page.evaluate(f"[{posters}, {ELEMENT}.status.gaussians]") == [0, 0]
        assert page.evaluate(saved) == pytest.approx(first, abs=1e-5)
        before = page.evaluate(painted)
        page.evaluate(f"{ELEMENT}.setAttribute('viewpoint', '{words[1]}')")
        page.wait_for(f"{painted} !== '{before}'")
        page.evaluate("go()")
        page.wait_for(f"{ELEMENT}.status.verified && {ELEMENT}.view")
        assert page.evaluate(f"[{posters}]") == [0]
        assert page.evaluate(saved) == pytest.approx(second, abs=1e-5)
        assert page.resolve(COLOURS)

    driven(streams, work, {"preview": HELD + ONE.format(src="ball.swz", more=more, style=SIZE)})


def test_error_of_the_decoding_thread_is_reported(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}without-memory")
        assert page.wait_for(f"{ELEMENT}?.status?.failed") == "no memory"

    driven(streams, work)


def test_refused_renderer_is_requested_again_after_a_lost_context(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}plain")
        page.evaluate(f"""(() => {{
          window.before = {ELEMENT}.view;
          window.refused = 0;
          {GET} function (kind, ...more) {{
            return kind.startsWith("webgl") && refused < 2 && ++refused ? null : get.call(this, kind, ...more); }};
          get.call(before.canvas, "webgl2").getExtension("WEBGL_lose_context").loseContext();
        }})()""")
        page.wait_for(f"{ELEMENT}.view && {ELEMENT}.view !== before")
        assert page.evaluate("refused") == 2
        assert page.evaluate(f"{ELEMENT}.status.failed") is None
        assert page.resolve(COLOURS)

    driven(streams, work)


def test_element_restored_from_zero_height_renders_at_once(streams: dict[str, bytes]) -> None:
    sizes = f"new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(() => resolve([\
{ELEMENT}.view.canvas.width, {ELEMENT}.view.canvas.height].join()))))"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}plain")
        before, look = page.resolve(sizes), page.evaluate(LOOK)
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 400px; height: 0; min-height: 0'")
        page.resolve(sizes)  # two frames: the element has heard of its new size
        page.resolve(f"{ELEMENT}.view.frame()")
        assert page.resolve(sizes) == before, "a picture without height would be stretched at first"
        page.evaluate(f"{ELEMENT}.style.cssText = '{SIZE}'")
        assert page.resolve(sizes) == before
        assert page.evaluate(LOOK) == look

    driven(streams, work)


def test_capture_from_a_camera_works_at_zero_height(streams: dict[str, bytes]) -> None:
    cameras = tiny_cameras(1, 240, 180)
    camera = {"viewmat": cameras.viewmats[0].tolist(), "focal": float(cameras.Ks[0, 1, 1]), "width": 240, "height": 180}
    picture = f"{ELEMENT}.picture({json.dumps(camera)})"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}anchors")
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 400px; height: 0; min-height: 0'")
        page.wait_for(f"{ELEMENT}.view.canvas.clientHeight === 0")
        flat = page.resolve(picture)
        page.evaluate(f"{ELEMENT}.style.cssText = '{SIZE}'")
        page.wait_for(f"{ELEMENT}.view.canvas.clientHeight > 0")
        assert page.resolve(picture) == flat

    driven(streams, work)


def test_long_message_covers_at_most_half_of_a_small_element(streams: dict[str, bytes]) -> None:
    canvas = f"{ELEMENT}.view.canvas"

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}anchors")
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: 240px; height: 180px'")
        page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.state').className = 'state bad'")
        page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.state').textContent = 'damaged packets '.repeat(40)")
        page.resolve("new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))")
        assert page.evaluate(f"{canvas}.clientHeight") == 180
        assert page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.foot').offsetHeight") <= 90

    driven(streams, work)


@pytest.mark.parametrize("name", ["plain", "turned", "flat", "zoomed"])
def test_picking_works_in_a_transformed_element(streams: dict[str, bytes], name: str) -> None:
    """The browser's position of a marker in the element is the reference."""
    mark = f"""(() => {{
      const dot = document.createElement("i");
      dot.style.cssText = "position: absolute; left: 300px; top: 60px; width: 0; height: 0";
      {ELEMENT}.shadowRoot.querySelector(".scene").append(dot);
      const {{ x, y }} = dot.getBoundingClientRect();
      return [x, y];
    }})()"""

    def work(host: Host, page: Browser) -> None:
        page.emulate(800, 600)
        opened(page, f"{host.url}{name}")
        page.evaluate(SPIED)
        page.double_click(*page.evaluate(mark))
        place = page.wait_for("places.length && places[0]")
        assert abs(place["x"] - 300) < 3, place
        assert abs(place["y"] - 60) < 3, place

    driven(streams, work)


def test_canvas_has_the_resolution_of_a_zoomed_element(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}zoomed")
        assert page.evaluate(f"[{ELEMENT}.view.canvas.width, {ELEMENT}.view.canvas.height]") == [600, 450]

    driven(streams, work)


def test_wheel_and_one_finger_scroll_the_page_on_request(streams: dict[str, bytes]) -> None:
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


def test_element_moved_to_another_document_keeps_its_style_and_continues(streams: dict[str, bytes]) -> None:
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


def test_element_in_another_window_continues_while_that_of_its_script_has_no_frames(streams: dict[str, bytes]) -> None:
    """A browser gives no animation frames to a hidden window, such as that behind a picture-in-picture window."""

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}frame")
        page.evaluate(f"""(() => {{
          window.moved = {ELEMENT};
          window.requestAnimationFrame = () => 1;
          moved.addEventListener("camerachange", () => (window.heard = true));
          document.querySelector("iframe").contentDocument.body.append(moved);
        }})()""")
        page.resolve("moved.view.frame()")
        assert page.resolve("moved.flyTo('0 0 -6 0 0 0 0 -1 0', 0.1)") is True
        page.wait_for("window.heard")
        before = page.evaluate("moved.saveView()")
        page.evaluate("moved.autorotate = '90'")
        page.wait_for(f"moved.saveView() !== '{before}'")

    driven(streams, work)


def test_hotspots_of_any_document_follow_the_scene_and_keep_their_keys(streams: dict[str, bytes]) -> None:
    key = (
        "dispatchEvent(new KeyboardEvent('keydown', {{ key: '{}', bubbles: true, composed: true, cancelable: true }}))"
    )

    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}frame")
        page.evaluate(f"""(() => {{
          window.made = document.querySelector("iframe").contentDocument.createElement("p");
          Object.assign(made, {{ slot: "hotspot", innerHTML: "<textarea></textarea><i contenteditable></i>" }});
          made.dataset.position = "0 0 0";
          {ELEMENT}.append(made);
        }})()""")
        page.wait_for("made.style.visibility === 'visible' && made.style.transform")
        for name in ("f", "h", "?", "ArrowLeft", "+"):
            for field in ("textarea", "i"):
                assert page.evaluate(f"made.querySelector('{field}').{key.format(name)}"), f"{name} in a {field}"
            assert not page.evaluate(f"{ELEMENT}.{key.format(name)}"), name

    driven(streams, work)


def test_element_of_a_removed_frame_releases_all_resources_and_restarts(streams: dict[str, bytes]) -> None:
    def work(host: Host, page: Browser) -> None:
        opened(page, f"{host.url}frame")
        page.evaluate(f"window.moved = {ELEMENT}; moved.setAttribute('panel', 'open')")
        page.evaluate("document.querySelector('iframe').contentDocument.body.append(moved)")
        page.resolve("moved.view.frame()")
        page.evaluate("document.querySelector('iframe').remove()")
        page.wait_for("window.workers === 0")
        assert page.evaluate("alive()") == {"contexts": 0, "workers": 0, "urls": 2, "observers": 0}
        page.evaluate("document.body.append(moved)")
        page.wait_for("moved.status.verified && moved.view")

    driven(streams, work)
