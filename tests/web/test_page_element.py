"""The element on somebody else's page: it gives everything back, survives moves and lost links, and says what is so."""

import asyncio
from collections.abc import Callable

import pytest

from explicit import encode_splats
from moving_clips import moving_frames
from splatwire.clips import ClipOptions, encode_clip
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.levels import encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization, SceneStream, stream_to_bytes
from splatwire.packets.packet import make_packet
from transport.chromium import Browser, browser, executable
from web.host import Host, hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
SCRIPT = '<script type="module" src="splatwire.js"></script>'
ONE = f'{SCRIPT}<splat-wire src="ball.swz" panel="open" style="height: 12rem"></splat-wire>'
NONE = f'{SCRIPT}<canvas id="theirs"></canvas><div id="a"></div><div id="b"></div>'
BROKEN = f"<script>HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {{apply: \
(get, canvas, [kind, ...more]) => kind.startsWith('webgl') ? null : get.call(canvas, kind, ...more)}});</script>{ONE}"
LATE = f"<script>const heard = EventTarget.prototype.addEventListener; \
Worker.prototype.addEventListener = function (kind, handler) {{\
heard.call(this, kind, (event) => setTimeout(() => handler.call(this, event), 300))}};</script>{ONE}"
PAGES = {"one": ONE, "none": NONE, "broken": BROKEN, "late": LATE}
PANEL = f"{ELEMENT}.shadowRoot.querySelector('.panel').innerText"
DRAWN = "[...document.querySelectorAll('splat-wire')].filter((one) => one.view)"
LOADED = "events.find(([kind]) => kind === 'load')"
MAKE = "(() => {{const made = document.createElement('splat-wire'); made.src = '{src}'; \
made.style.height = '6rem'; document.querySelector('{where}').append(made); return true}})()"


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))


def hosted(stream: SceneStream, work: Callable[[Host, Browser], None], **others: bytes) -> None:
    """Does something with a browser and a site that has the stream as `ball.swz`."""

    async def serve() -> None:
        async with hosting(PAGES, {"ball.swz": stream_to_bytes(stream), **others}) as host:

            def drive() -> None:
                with browser() as page:
                    work(host, page)

            await asyncio.to_thread(drive)

    run(serve())


def made(page: Browser, src: str = "ball.swz", where: str = "#a") -> None:
    page.evaluate(MAKE.format(src=src, where=where))


def test_elements_that_come_and_go_leave_nothing(stream: SceneStream) -> None:
    """More of them than a browser has contexts; what the host page draws stays. Two scripts of workers are kept."""

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        page.evaluate("window.theirs = document.querySelector('#theirs').getContext('webgl2'); 0")
        left: list[dict[str, int]] = []
        for n in range(18):
            made(page)
            page.wait_for(f"{ELEMENT}.view && {LOADED}")
            if n == 0:
                assert page.evaluate("alive()") == {"contexts": 2, "workers": 2, "urls": 2, "observers": 2}
            page.evaluate(f"{ELEMENT}.remove(); events.length = 0")
            page.wait_for("window.workers === 0")
            assert page.evaluate("alive()") == {"contexts": 1, "workers": 0, "urls": 2, "observers": 0}
            left.append({name: count for name, count in page.alive().items() if name != "JSHeapUsedSize"})
        assert left[0]["WorkerGlobalScopes"] == 0
        for name in left[0]:  # a moment's own objects come and go; what each of the elements left would add up
            counts = [one[name] for one in left]
            assert min(counts[9:]) <= max(counts[:9]), (name, counts)
        assert page.evaluate("window.theirs.isContextLost()") is False

    hosted(stream, work)


def test_an_element_that_is_moved_goes_on_and_one_that_is_gone_begins_anew(stream: SceneStream) -> None:
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


def test_attributes_are_followed_properties_reflect_and_events_are_told(stream: SceneStream) -> None:
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
        assert page.evaluate(f"{ELEMENT}.panel.settings.concealer") == "drop"
        page.wait_for(f"{ELEMENT}.view")
        page.evaluate(f"{ELEMENT}.viewpoint = '0 0 -3 0 0 0 0 -1 0'")
        assert page.evaluate(f"{ELEMENT}.view.orbit.placed")
        page.evaluate(f"{ELEMENT}.setAttribute('panel', 'none')")
        assert page.evaluate(f"{ELEMENT}.panel.element.hidden")
        page.evaluate(f"events.length = 0; {ELEMENT}.src = 'nothing.swz'")
        assert "404" in page.wait_for("events.find(([kind]) => kind === 'error')")[1]["message"]
        page.evaluate(f"events.length = 0; {ELEMENT}.src = 'ball.swz'")
        page.wait_for(LOADED)
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    hosted(stream, work)


SETTLED = """(async () => {{
  const view = {element}.view, pause = () => new Promise((resolve) => setTimeout(resolve, 100));
  const moved = async (yaw) => {{ view.orbit.yaw = yaw; await view.frame(); }};
  const settled = async () => {{
    let picture = "";
    for (let same = 0; same < 20; ) {{
      await pause();
      view.canvas.toDataURL();
      await view.frame();
      const now = view.canvas.toDataURL();
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
  return first === (await settled());
}})()"""
"""Whether a view at rest is the same whatever moved before."""


def test_depths_are_sorted_for_where_the_camera_rests(stream: SceneStream) -> None:
    """Its engine does not sort for a camera that moves while it sorts."""

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}late")  # where its worker answers late
        page.wait_for(f"{ELEMENT}.view && {LOADED}")
        assert page.resolve(SETTLED.format(element=ELEMENT)) is True

    hosted(stream, work)


def test_many_elements_share_few_contexts(stream: SceneStream) -> None:
    """Twelve in sight have eight; the others get theirs when some go. One that was taken away comes again."""
    views = f"{DRAWN}.length"

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}none")
        page.wait_for("customElements.get('splat-wire')")
        page.evaluate("document.body.insertAdjacentHTML('beforeend', '<style>#a {display: grid; "
                      "grid-template-columns: repeat(6, 1fr)}</style>')")  # fmt: skip
        for _ in range(12):
            made(page)
        page.wait_for("events.filter(([kind]) => kind === 'load').length === 12", 120)
        page.wait_for(f"{views} === 8", 120)
        painted = "[...document.querySelectorAll('splat-wire')].filter((one) => !one.view && \
one.shadowRoot.querySelector('.first.shown')).length"
        page.wait_for(f"{painted} === 4")
        page.evaluate(f"{DRAWN}.slice(2).forEach((one) => one.remove())")
        page.wait_for(f"{views} === 6", 120)
        page.evaluate(f"window.before = {ELEMENT}.view")
        page.evaluate("before.canvas.getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()")
        page.wait_for(f"{ELEMENT}.view && {ELEMENT}.view !== before", 120)
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    hosted(stream, work)


def test_a_link_that_drops_is_tried_again_and_a_page_that_is_loaded_again_goes_on(stream: SceneStream) -> None:
    size = len(stream_to_bytes(stream))

    def work(host: Host, page: Browser) -> None:
        host.deliver = lambda request, body: size * 6 // 10 if len(host.asked) == 1 else 0
        page.open(f"{host.url}one")
        page.wait_for(f"{ELEMENT}?.status?.packets > 0")
        host.cut.set()
        assert page.wait_for("events.find(([kind]) => kind === 'lost')")[1]["retryMs"] > 0
        told = page.wait_for(f"{ELEMENT}.status.packets > 0 && {PANEL}.includes('The link dropped') && {PANEL}")
        assert "none" not in told.partition("missing")[2].partition("received")[0]
        assert "no loss" not in told
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


def test_a_file_that_was_replaced_is_shown_whole_on_the_next_visit(stream: SceneStream) -> None:
    """Whatever kind of scene was kept, and from a server with ranges or without."""
    levels = encode_levels(SplatScene(ball()), Packetization(block_size=40, lanes=2))
    files = {len(one.packets): stream_to_bytes(one) for one in (levels, stream)}

    def work(host: Host, page: Browser) -> None:
        for host.ranges in (False, True):
            for packets in (*files, *files):
                host.streams["ball.swz"] = files[packets]
                for _ in range(2):
                    page.open("about:blank")
                    page.open(f"{host.url}one")
                    assert page.wait_for(f"window.events && {LOADED}")[1] == {"complete": True, "verified": True}
                    assert page.evaluate(f"{ELEMENT}.status.expected") == packets
                    assert page.evaluate("events.filter(([kind]) => kind === 'error' || kind === 'lost').length") == 0

    assert len(files) == 2
    hosted(stream, work)


def test_what_was_altered_or_cannot_be_drawn_is_not_called_whole(stream: SceneStream) -> None:
    first = stream.packets[0]
    payload = bytes(byte ^ 0x55 for byte in first.payload)
    altered = make_packet(first.id, first.num_elements, payload, stream.manifest.stream_id)
    changed = stream.with_packets([altered, *stream.packets[1:]])

    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}one")
        assert page.wait_for(LOADED)[1] == {"complete": True, "verified": False}
        assert "not what was encoded" in page.evaluate(f"{ELEMENT}.status.failed")
        assert "Everything is there" not in page.evaluate(PANEL)
        host.streams["ball.swz"] = stream_to_bytes(stream)
        page.open("about:blank")
        page.open(f"{host.url}broken")
        page.wait_for(f"window.events && {LOADED} && {ELEMENT}.status.failed")
        assert "no WebGL 2" in page.evaluate(PANEL)
        assert page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.first').classList.contains('shown')")

    hosted(changed, work)


@pytest.mark.parametrize("kind", ["clip", "levels"])
def test_what_moves_and_what_has_levels_comes_moves_and_goes_as_well(kind: str, stream: SceneStream) -> None:
    """Whole by its digest, after a link that dropped, a move within the page and an element that was taken away."""
    small = Packetization(block_size=40, lanes=2)
    made_of = (
        encode_clip(moving_frames(300, 5), ClipOptions(group_frames=3))[0]
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
            way, packets, expected = (page.evaluate(f"{ELEMENT}.status.{x}") for x in ("way", "packets", "expected"))
            assert ("kept" in way) == (n > 0), way
            assert packets == expected == len(made_of.packets)
            page.evaluate(f"window.view = {ELEMENT}.view; document.querySelector('#b').append({ELEMENT})")
            page.resolve("new Promise((resolve) => setTimeout(resolve, 50))")
            assert page.evaluate(f"{ELEMENT}.view === view") is True
            page.evaluate(f"{ELEMENT}.remove(); events.length = 0")
            page.wait_for("window.workers === 0")
        page.resolve("caches.delete('splatwire-2')")
        begun = len(host.asked)
        host.deliver = lambda request, body: len(body) * 6 // 10 if len(host.asked) == begun + 1 else None
        host.cut.set()
        made(page, "other.swz")
        assert page.wait_for("events.find(([kind]) => kind === 'lost')")[1]["retryMs"] > 0
        assert page.wait_for(LOADED)[1] == whole
        assert page.resolve(f"{ELEMENT}.verify()") is True
        page.evaluate(f"{ELEMENT}.src = 'ball.swz'; events.length = 0")  # a scene that stands still takes its place
        assert page.wait_for(LOADED)[1] == whole
        page.wait_for(f"{ELEMENT}.status.gaussians === {stream.manifest.num_elements}")

    hosted(stream, work, **{"other.swz": file})
