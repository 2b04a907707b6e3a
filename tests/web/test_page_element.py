"""The element on a third-party page: it releases resources, survives moves and lost links, and reports its state."""

import asyncio
import base64
from collections.abc import Callable

import numpy as np
import pytest

from explicit import encode_splats
from moving_sequences import moving_frames
from splatwire.bitstream import Packetization, SceneStream, stream_to_bytes
from splatwire.bitstream.packet import make_packet
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.preview import MAX_LEVELS, Preview, PreviewQuantisation, write_preview
from splatwire.lod import encode_levels
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.types import SplatScene
from splatwire.types.metadata import SceneMetadata
from transport.chromium import Browser, executable, isolated_page
from web.host import Host, hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
SCRIPT = '<script type="module" src="splatwire.js"></script>'
ONE = f'{SCRIPT}<splat-wire src="ball.swz" panel="open" style="height: 12rem"></splat-wire>'
NONE = f'{SCRIPT}<canvas id="theirs"></canvas><div id="a"></div><div id="b"></div>'
BROKEN = f"<script>HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {{apply: \
(get, canvas, [kind, ...more]) => kind.startsWith('webgl') ? null : get.call(canvas, kind, ...more)}});</script>{ONE}"
LATE = f"<script>const heard = EventTarget.prototype.addEventListener; \
Worker.prototype.addEventListener = function (kind, handler) {{\
heard.call(this, kind, (event) => setTimeout(() => handler.call(this, event), 300))}};</script>{ONE}"
NAMED = f'{SCRIPT}<splat-wire src="ball.swz" panel="open" aria-label="Our yard" style="height: 12rem"></splat-wire>'
PAGES = {"named": NAMED, "one": ONE, "none": NONE, "broken": BROKEN, "late": LATE}
PANEL = f"{ELEMENT}.shadowRoot.querySelector('.panel').innerText"
DRAWN = "[...document.querySelectorAll('splat-wire')].filter((one) => one.view)"
NEXT_FRAMES = "new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))"
LOADED = "events.find(([kind]) => kind === 'load')"
MAKE = "(() => {{const made = document.createElement('splat-wire'); made.src = '{src}'; \
made.style.height = '6rem'; document.querySelector('{where}').append(made); return true}})()"


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))


def hosted(stream: SceneStream, work: Callable[[Host, Browser], None], **others: bytes) -> None:
    """Runs work in a browser on a site that has the stream as `ball.swz`."""

    async def serve() -> None:
        async with hosting(PAGES, {"ball.swz": stream_to_bytes(stream), **others}) as host:

            def drive() -> None:
                with isolated_page() as page:
                    work(host, page)

            await asyncio.to_thread(drive)

    run(serve())


def made(page: Browser, src: str = "ball.swz", where: str = "#a") -> None:
    page.evaluate(MAKE.format(src=src, where=where))


def test_panel_shows_the_metadata_and_the_origin_of_the_stream() -> None:
    metadata = SceneMetadata(title="Yard <b>at</b> dawn", author="Ada\n\u202e Lovelace", license="CC BY 4.0")
    scene = SplatScene(ball(), metadata=metadata, origin=(500000.25, 5400000.0, 120.0))
    rows = ["Yard <b>at</b> dawn", "Ada Lovelace", "CC BY 4.0", "500000.25, 5400000, 120"]
    values = f"""[...{ELEMENT}.shadowRoot.querySelectorAll('dt')].filter(({{textContent}}) =>
        ['title', 'author', 'license', 'origin'].includes(textContent)).map((row) => row.nextSibling.textContent)"""
    title = f"{ELEMENT}.shadowRoot.querySelector('.title').textContent"

    def work(host: Host, page: Browser) -> None:
        for name, expected in (("one", "Yard <b>at</b> dawn"), ("named", "Our yard")):
            page.open(f"{host.url}{name}")
            page.wait_for(LOADED)
            assert page.evaluate(values) == rows
            assert page.evaluate(title) == expected
        host.streams["ball.swz"] = stream_to_bytes(encode_splats(ball(), SMALL))
        page.open(f"{host.url}one")
        page.wait_for(LOADED)
        assert page.evaluate(f"[{values}.length, {title}]") == [0, "ball"]

    hosted(encode_scene(scene, SMALL), work)


def test_removed_elements_release_all_resources(stream: SceneStream) -> None:
    """Elements leave no context and no worker, restarts leave no controls, and the host page keeps its drawings."""

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        page.evaluate("window.theirs = document.querySelector('#theirs').getContext('webgl2'); 0")
        left: list[dict[str, int]] = []
        kept = "window.kept"  # by the page, also when it is removed
        for n in range(8):
            made(page)
            page.wait_for(f"{ELEMENT}.view?.shows && {LOADED}")
            if n == 0:
                assert page.evaluate("alive()") == {"contexts": 2, "workers": 2, "urls": 2, "observers": 2}
            page.evaluate(f"{kept} = {ELEMENT}; {kept}.addEventListener('camerachange', () => (window.moved = true))")
            page.evaluate(f"{kept}.view.orbit.yaw += 1; {kept}.remove(); events.length = 0")
            page.wait_for("window.workers === 0")
            page.resolve(NEXT_FRAMES)
            assert page.evaluate(f"[{kept}.shadowRoot.childElementCount, !!window.moved]") == [0, False]
            assert page.evaluate("alive()") == {"contexts": 1, "workers": 0, "urls": 2, "observers": 0}
            left.append({name: count for name, count in page.alive().items() if name != "JSHeapUsedSize"})
        assert left[0]["WorkerGlobalScopes"] == 0
        for name in left[0]:  # temporary objects vary; one that each element left would add 4
            counts = [one[name] for one in left]
            assert min(counts[4:]) - min(counts[:4]) < 4, (name, counts)
        assert page.evaluate("window.theirs.isContextLost()") is False
        made(page)
        page.evaluate("window.containers = []; 0")
        for _ in range(3):
            page.wait_for(f"{ELEMENT}.view?.shows && {LOADED}")
            page.evaluate(f"containers.push(new WeakRef({ELEMENT}.shadowRoot.firstElementChild)); events.length = 0")
            page.evaluate(f"{ELEMENT}.retry(); 0")
        page.wait_for(f"{ELEMENT}.view?.shows && {LOADED}")
        page.alive()  # collects garbage
        assert page.evaluate("containers.filter((container) => container.deref()).length") == 0

    hosted(stream, work)


def test_previews_of_small_scenes_are_drawn(stream: SceneStream) -> None:
    """An element without an answer and a thumbnail paint the Gaussians of the preview, not only the background."""
    levels = np.random.default_rng(1).integers(0, 1 + np.array(MAX_LEVELS), (90, len(MAX_LEVELS)))
    frame = PreviewQuantisation.fitting((1e-3, 0.0, 0.0), 1e-3, [-1.2, -1.2, -1.2, -2.5], [1.2, 1.2, 1.2, -1.0])
    data = base64.b64encode(write_preview(Preview(frame, (0, 0, 0), levels))).decode()
    colours = """(canvas) => canvas?.width > 1 && new Set(canvas.getContext("2d").getImageData(
        0, 0, canvas.width, canvas.height).data).size"""

    def work(host: Host, page: Browser) -> None:
        host.deliver = lambda request, body: 0
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        page.evaluate(
            f"""document.querySelector("#a").innerHTML = `<splat-wire src="ball.swz" preview="{data}"></splat-wire>
            <splat-wire-preview data="{data}"></splat-wire-preview>`"""
        )
        for canvas in (f"{ELEMENT}.shadowRoot.querySelector('.first')", "document.querySelector('#a canvas')"):
            page.wait_for(f"({colours})({canvas}) > 50")  # the background may be painted first

    hosted(stream, work)


def test_moved_element_continues_and_removed_element_restarts(stream: SceneStream) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        made(page)
        page.evaluate(f"window.before = {ELEMENT}.status; document.querySelector('#b').append({ELEMENT})")
        page.wait_for(LOADED)
        assert page.evaluate(f"before === {ELEMENT}.status && before.verified") is True
        page.wait_for(f"{ELEMENT}.view")
        started = page.evaluate("window.workers")
        page.evaluate(f"window.kept = {ELEMENT}; window.view = kept.view; document.querySelector('#a').append(kept)")
        page.resolve("new Promise((resolve) => setTimeout(resolve, 50))")
        assert page.evaluate("kept.view === view") is True
        assert page.evaluate("window.workers") == started
        page.evaluate("kept.remove(); events.length = 0")
        page.wait_for("window.workers === 0")
        page.evaluate("document.querySelector('#a').append(kept)")
        page.wait_for(f"{LOADED} && kept.view && kept.status !== before")

    hosted(stream, work)


def test_element_recovers_from_a_missing_or_invalid_address(stream: SceneStream) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        made(page, "http://[")
        page.wait_for(f"events.length && {ELEMENT}.status.failed")
        assert page.evaluate("events") == [["error", {"message": page.evaluate(f"{ELEMENT}.status.failed")}]]
        assert page.evaluate(f"{ELEMENT}.status.failed").endswith("is not a valid URL: http://[")
        page.evaluate(f"events.length = 0; {ELEMENT}.src = 'ball.swz'")
        page.wait_for(f"{ELEMENT}.status.verified")
        page.evaluate(f"{ELEMENT}.remove(); document.querySelector('#a').append(document.createElement('splat-wire'))")
        page.wait_for(f"{ELEMENT}.status.failed")
        page.evaluate(f"{ELEMENT}.remove(); events.length = 0")
        page.evaluate(
            "document.querySelector('#a').append(document.createElement('splat-wire'));"
            f"{ELEMENT}.style.height = '6rem'; {ELEMENT}.src = 'ball.swz'"
        )
        page.wait_for(LOADED)
        assert page.evaluate("events.filter(([kind]) => kind === 'error')") == []

    hosted(stream, work)


def test_attributes_properties_and_events_are_consistent(stream: SceneStream) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}one")
        detail = page.wait_for(LOADED)[1]
        assert detail == {"complete": True, "verified": True}
        kinds = page.wait_for("events.some(([kind]) => kind === 'firstpicture') && events.map(([kind]) => kind)")
        assert set(kinds) == {"progress", "firstpicture", "load"}
        assert page.evaluate("events.find(([kind]) => kind === 'firstpicture')[1].ms > 0")
        progress = page.evaluate("events.filter(([kind]) => kind === 'progress').pop()[1]")
        assert progress["packets"] == progress["expected"] == len(stream.packets)
        sliders = f"{ELEMENT}.shadowRoot.querySelectorAll('input[type=range]')"
        assert page.evaluate(f"[...{sliders}].every((slider) => slider.ariaLabel)"), "a slider without a name"
        page.evaluate(f"{ELEMENT}.concealer = 'drop'")
        assert page.evaluate(f"{ELEMENT}.getAttribute('concealer')") == "drop"
        assert page.evaluate(f"{ELEMENT}.controlPanel.settings.concealer") == "drop"
        page.wait_for(f"{ELEMENT}.view")
        page.evaluate(f"{ELEMENT}.viewpoint = '0 0 -3 0 0 0 0 -1 0'")
        assert page.evaluate(f"{ELEMENT}.view.orbit.placed")
        page.evaluate(f"{ELEMENT}.setAttribute('panel', 'none')")
        assert page.evaluate(f"{ELEMENT}.controlPanel.element.hidden")
        page.evaluate(f"events.length = 0; {ELEMENT}.src = 'nothing.swz'")
        assert "404" in page.wait_for("events.find(([kind]) => kind === 'error')")[1]["message"]
        page.evaluate(f"events.length = 0; {ELEMENT}.src = 'ball.swz'")
        page.wait_for(LOADED)
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    hosted(stream, work)


SETTLED = """(async () => {{
  const view = {element}.view, pause = () => new Promise((resolve) => setTimeout(resolve, 100));
  const drawn = async () => {{ await view.sorted(); await view.frame(); return view.canvas.toDataURL(); }};
  const moved = async (yaw) => {{ view.orbit.yaw = yaw; await view.frame(); }};
  const settled = async () => {{
    let picture = "";
    for (let same = 0; same < 20; ) {{
      await pause();
      const now = await drawn();
      same = now === picture ? same + 1 : 0;
      picture = now;
    }}
    return picture;
  }};
  for (let step = 0; step <= 20; step++) await moved(step * 0.3);
  const first = await settled();
  await moved(3);
  await settled();
  await moved(6);
  for (let n = 0; n < 100; n++) {{
    if (first === (await drawn())) return true;
    await pause();
  }}
  return false;
}})()"""
"""Returns True if a resting view is the same after any movement."""


def test_depth_order_matches_the_resting_camera(stream: SceneStream) -> None:
    """The sorter does not restart for a camera that moves during a sort."""

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}late")  # where its worker answers late
        page.wait_for(f"{ELEMENT}.view && {LOADED}")
        assert page.resolve(SETTLED.format(element=ELEMENT)) is True

    hosted(stream, work)


def test_many_elements_share_few_webgl_contexts(stream: SceneStream) -> None:
    """Eight of twelve visible elements have a context; the others get one when some are removed.

    A removed element returns.
    """
    views = f"{DRAWN}.length"

    def work(host: Host, page: Browser) -> None:
        page.emulate(800, 600)  # all elements are visible
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        page.evaluate("document.body.insertAdjacentHTML('beforeend', '<style>#a {display: grid; "
                      "grid-template-columns: repeat(6, 1fr)}</style>')")  # fmt: skip
        for _ in range(12):
            made(page)
        page.wait_for("events.filter(([kind]) => kind === 'load').length === 12")
        page.wait_for(f"{views} === 8")
        painted = "[...document.querySelectorAll('splat-wire')].filter((one) => !one.view && \
one.shadowRoot.querySelector('.first.shown')).length"
        page.wait_for(f"{painted} === 4")
        page.evaluate(f"{DRAWN}.slice(2).forEach((one) => one.remove())")
        page.wait_for(f"{views} === 6")
        page.evaluate(f"window.before = {ELEMENT}.view")
        page.evaluate("before.canvas.getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()")
        page.wait_for(f"{ELEMENT}.view && {ELEMENT}.view !== before")
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    hosted(stream, work)


def test_dropped_link_is_retried_and_a_reloaded_page_resumes(stream: SceneStream) -> None:
    size = len(stream_to_bytes(stream))

    def work(host: Host, page: Browser) -> None:
        host.deliver = lambda request, body: size * 6 // 10 if len(host.asked) == 1 else 0
        page.open(f"{host.url}one")
        page.wait_for(f"{ELEMENT}?.status?.packets > 0")
        host.cut.set()
        assert page.wait_for("events.find(([kind]) => kind === 'lost')")[1]["retryMs"] > 0
        panel = page.wait_for(f"{ELEMENT}.status.packets > 0 && {PANEL}.includes('Connection lost') && {PANEL}")
        assert "none" not in panel.partition("missing")[2].partition("received")[0]
        assert "no loss" not in panel
        assert page.evaluate(f"{ELEMENT}.status.finished") is None
        page.wait_for("events.filter(([kind]) => kind === 'lost').length > 1")
        host.deliver = lambda request, body: None
        assert page.wait_for(LOADED)[1] == {"complete": True, "verified": True}
        assert all("range" in request.headers for request in host.asked[1:])
        assert host.sent < 1.01 * size + 4096
        before = host.sent
        page.open("about:blank")
        page.open(f"{host.url}one")
        assert page.wait_for(f"window.events && {LOADED}")[1] == {"complete": True, "verified": True}
        assert 0 < host.sent - before < 1000, "the manifest is compared, and nothing else comes again"
        assert "kept by this browser" in page.evaluate(PANEL)

    hosted(stream, work)


def test_replaced_file_is_loaded_completely_on_the_next_visit(stream: SceneStream) -> None:
    """Covers any kind of cached scene, and servers with and without ranges."""
    levels = encode_levels(SplatScene(ball()), Packetization(block_size=40, lanes=2))
    files = {len(one.packets): stream_to_bytes(one) for one in (levels, stream)}

    def work(host: Host, page: Browser) -> None:
        for host.ranges in (False, True):
            for packets in files:  # the first of the second server replaces the last of the first
                host.streams["ball.swz"] = files[packets]
                for _ in range(2):
                    page.open("about:blank")
                    page.open(f"{host.url}one")
                    assert page.wait_for(f"window.events && {LOADED}")[1] == {"complete": True, "verified": True}
                    assert page.evaluate(f"{ELEMENT}.status.expected") == packets
                    assert page.evaluate("events.filter(([kind]) => kind === 'error' || kind === 'lost').length") == 0

    assert len(files) == 2
    hosted(stream, work)


def test_altered_or_undrawable_streams_are_not_reported_as_complete(stream: SceneStream) -> None:
    first = stream.packets[0]
    payload = bytes(byte ^ 0x55 for byte in first.payload)
    altered = make_packet(first.id, first.num_elements, payload, stream.manifest.stream_id)
    changed = stream.with_packets([altered, *stream.packets[1:]])

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}one")
        assert page.wait_for(LOADED)[1] == {"complete": True, "verified": False}
        assert "their digest is wrong" in page.evaluate(f"{ELEMENT}.status.failed")
        assert "Complete and verified" not in page.evaluate(PANEL)
        host.streams["ball.swz"] = stream_to_bytes(stream)
        page.open("about:blank")
        page.open(f"{host.url}broken")
        page.wait_for(f"window.events && {LOADED} && {ELEMENT}.status.failed")
        assert "no WebGL 2" in page.evaluate(PANEL)
        assert page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.first').classList.contains('shown')")

    hosted(changed, work)


@pytest.mark.parametrize("kind", ["clip", "levels"])
def test_clips_and_levels_are_loaded_moved_and_removed(kind: str, stream: SceneStream) -> None:
    """The digest is verified after a dropped link, a move within the page and a removed element."""
    small = Packetization(block_size=40, lanes=2)
    made_of = (
        encode_sequence(moving_frames(300, 5), SequenceOptions(group_frames=3))[0]
        if kind == "clip"
        else encode_levels(SplatScene(ball()), small)
    )
    file, whole = stream_to_bytes(made_of), {"complete": True, "verified": True}

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        for n in range(3):
            made(page, "other.swz")
            assert page.wait_for(f"{ELEMENT}.view && {LOADED}")[1] == whole
            transport, packets, expected = (
                page.evaluate(f"{ELEMENT}.status.{x}") for x in ("transport", "packets", "expected")
            )
            assert ("kept" in transport) == (n > 0), transport
            assert packets == expected == len(made_of.packets)
            page.evaluate(f"window.view = {ELEMENT}.view; document.querySelector('#b').append({ELEMENT})")
            page.resolve("new Promise((resolve) => setTimeout(resolve, 50))")
            assert page.evaluate(f"{ELEMENT}.view === view") is True
            page.evaluate(f"{ELEMENT}.remove(); events.length = 0")
            page.wait_for("window.workers === 0")
        page.resolve("caches.keys().then((names) => Promise.all(names.map((name) => caches.delete(name))))")
        begun = len(host.asked)
        host.deliver = lambda request, body: len(body) * 6 // 10 if len(host.asked) == begun + 1 else None
        host.cut.set()
        made(page, "other.swz")
        if kind == "clip":  # the rest of a range of levels is requested at once
            assert page.wait_for("events.find(([kind]) => kind === 'lost')")[1]["retryMs"] > 0
        assert page.wait_for(LOADED)[1] == whole
        assert "kept" not in page.evaluate(f"{ELEMENT}.status.transport")
        assert page.resolve(f"{ELEMENT}.verify()") is True
        page.evaluate(f"{ELEMENT}.src = 'ball.swz'; events.length = 0")  # a still scene replaces it
        assert page.wait_for(LOADED)[1] == whole
        page.wait_for(f"{ELEMENT}.status.gaussians === {stream.manifest.num_elements}")

    hosted(stream, work, **{"other.swz": file})
