"""Uploads of a page to the GPU: only changes, in small steps, and never an empty picture."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from explicit import encode_splats
from scenes import tiny_cameras
from splatwire.bitstream import Packetization, SceneStream, stream_to_bytes
from splatwire.codec.gaussians.quality import Quality
from splatwire.lod import encode_levels
from splatwire.types import SplatScene
from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.pictures import ELEMENT, concealers_of
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
SCENE = '<script type="module" src="splatwire.js"></script>\
<splat-wire src="ball.swz" style="width: 240px; height: 180px"></splat-wire>'
LARGE = SCENE.replace("180px", "340px")
"""Size of the element without its panel: a smaller view need not load the finest tiles."""
LATE = f"""<script>const listen = EventTarget.prototype.addEventListener;
Worker.prototype.addEventListener = function (kind, handler) {{
  listen.call(this, kind, (event) => {{
    if (event.data?.sortTime === undefined) return handler.call(this, event);
    setTimeout(() => {{ window.sorted = true; handler.call(this, event); }}, 8000);
  }});
}};</script>{SCENE}"""
COUNTED = f"""<script>
window.uploaded = {{all: 0, task: 0, most: 0}};
const upload = WebGL2RenderingContext.prototype.texSubImage2D, {{port1, port2}} = new MessageChannel();
port1.onmessage = () => (uploaded.task = 0);
WebGL2RenderingContext.prototype.texSubImage2D = function (...given) {{
  const bytes = given[8]?.byteLength ?? 0;
  if (!uploaded.task) port2.postMessage(null);
  uploaded.all += bytes;
  uploaded.task += bytes;
  uploaded.most = Math.max(uploaded.most, uploaded.task);
  return upload.apply(this, given);
}};</script>{LARGE}"""
PATIENT = f"""<script>const later = setTimeout;
window.setTimeout = (work, ms, ...given) => ms >= 5000 ? 0 : later(work, ms, ...given);</script>{SCENE}"""
"""Setting without timeouts."""
BUSY = f"""<script>
const ask = WebGL2RenderingContext.prototype.getSyncParameter;
WebGL2RenderingContext.prototype.getSyncParameter = function (...given) {{
  return window.busy ? this.UNSIGNALED : ask.apply(this, given);
}};</script>{SCENE}"""
LINKING = f"""<script>
window.waited = window.unlinked = 0;
const context = WebGL2RenderingContext.prototype, until = new WeakMap(), COMPLETION = 0x91b1;
const PARALLEL = "KHR_parallel_shader_compile"; // which software renderers lack
const {{ linkProgram, getExtension, getSupportedExtensions, getProgramParameter }} = context;
context.getSupportedExtensions = function () {{
  return [...getSupportedExtensions.call(this), PARALLEL];
}};
context.linkProgram = function (program) {{
  until.set(program, performance.now() + 500);
  linkProgram.call(this, program);
}};
context.getExtension = function (name) {{
  if (name === PARALLEL) return {{ COMPLETION_STATUS_KHR: COMPLETION }};
  return getExtension.call(this, name);
}};
context.getProgramParameter = function (program, name) {{
  const early = performance.now() < until.get(program);
  if (name !== COMPLETION && early) window.waited++;
  if (name !== COMPLETION) return getProgramParameter.call(this, program, name);
  if (early) window.unlinked++;
  return !early;
}};</script>{SCENE}"""
"""Page where each shader takes half a second to link."""
TURNS = f"""(async () => {{
  const {{ view }} = {ELEMENT}, given = GIVEN, kinds = {{ centers: Float32Array, opacities: Float32Array }};
  const orders = given.map((order) => ({{ count: COUNT, degree: 0, harmonics: [], ...Object.fromEntries(
    Object.entries(order).map(([name, texels]) => [name, new (kinds[name] ?? Uint16Array)(texels)])) }}));
  const found = [];
  for (let n = 0; n < 30; n++) {{
    view.add(orders[n % 2], true);
    let shown = false;
    const sorted = view.replacementSorted().then(() => (shown = true));
    while (!shown) await Promise.race([n ? picture().then((drawn) => found.push(drawn)) : view.frame(), sorted]);
  }}
  async function picture() {{
    await view.frame();
    return view.canvas.toDataURL();
  }}
  return found;
}})()"""
"""Pictures while Gaussians are replaced repeatedly by the same ones in another order."""
FULL = """<script>
window.heard = [];
for (const kind of ["error", "unhandledrejection"]) window.addEventListener(kind, (event) => heard.push(String(
  event.reason ?? event.message)));
document.addEventListener("error", ({detail, target}) => target.localName === "splat-wire" && heard.push(
  `failed: ${detail.message}`), true);
window.attempts = 0;
window.retries = 0;
let isLoss = false;
const later = setTimeout, {dispatchEvent} = EventTarget.prototype;
window.setTimeout = (work, ms, ...given) => {
  retries += isLoss && ms === 1000;
  return later(work, ms, ...given);
};
EventTarget.prototype.dispatchEvent = function (event) {
  const before = isLoss;
  isLoss ||= event.type === "webglcontextlost";
  try {
    return dispatchEvent.call(this, event);
  } finally {
    isLoss = before;
  }
};
const context = WebGL2RenderingContext.prototype, {getError, texSubImage2D} = context, full = new WeakSet();
const isFull = (gl) => !full.has(gl) && (full.add(gl), attempts++ < ATTEMPTS);
</script>"""
"""Page that records errors, and counts the timers for another attempt that are set when a context is lost."""
FULL_GPU = (
    FULL
    + """<script>
context.getError = function () { return isFull(this) ? this.OUT_OF_MEMORY : getError.call(this); };</script>"""
)
"""Page with a WebGL that refuses memory at first, and reports it on request."""
FULL_PROCESS = (
    FULL
    + """<script>
context.texSubImage2D = function (...given) {
  if (isFull(this)) throw new RangeError("Array buffer allocation failed");
  return texSubImage2D.apply(this, given);
};</script>"""
)
"""Page in a process that has no memory left at first."""
FULL_PICTURE = (
    FULL
    + """<script>
context.getError = function () {
  return this.canvas.height > 1000 ? (attempts++, this.OUT_OF_MEMORY) : getError.call(this);
};</script>"""
).replace("ATTEMPTS", "0") + SCENE
"""Page on which WebGL refuses memory for large pictures."""
FULL_FRAME = (
    FULL
    + """<script>
const {drawElementsInstanced} = context;
context.drawElementsInstanced = function (...given) {
  if (isFull(this)) throw new RangeError("Array buffer allocation failed");
  return drawElementsInstanced.apply(this, given);
};</script>"""
)
"""Page with one frame that fails for lack of memory."""
FULL_DEFECT = FULL_FRAME.replace('RangeError("Array buffer allocation failed")', 'TypeError("a defect")')
"""Page with one frame that fails for another reason."""
FULL_PAGES = {
    f"{name}-{attempts}": page.replace("ATTEMPTS", str(attempts)) + SCENE
    for name, page in (("gpu", FULL_GPU), ("process", FULL_PROCESS), ("frame", FULL_FRAME), ("defect", FULL_DEFECT))
    for attempts in (1, 100)
}
WITHOUT = f"""{FULL.replace("ATTEMPTS", "0")}<script>
const {{getContext}} = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...given) {{
  return kind === "webgl2" && !window.works ? (attempts++, null) : getContext.call(this, kind, ...given);
}};</script>{SCENE}<div style="height: 3000px"></div>"""
"""Page without WebGL until `works` is true."""
PAGES = (
    FULL_PAGES
    | {"without": WITHOUT, "picture": FULL_PICTURE}
    | {"patient": PATIENT, "late": LATE, "counted": COUNTED, "busy": BUSY, "linking": LINKING}
)
WHOLE = f"{ELEMENT}?.status?.verified && {ELEMENT}.view?.shows"
CAMERAS = tiny_cameras(1, 240, 180)
CAMERA = {"viewmat": CAMERAS.viewmats[0].tolist(), "focal": float(CAMERAS.Ks[0, 1, 1]), "height": 180}


def on_page(name: str, stream: SceneStream, work: Callable[[Browser], None], *, held: str = "") -> None:
    """Runs work on one of the open pages. The stream is sent once the expression `held` is true."""

    async def serve() -> None:
        async with hosting(PAGES, {"ball.swz": stream_to_bytes(stream)}) as host:
            if held:
                host.deliver = lambda request, body: 0

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}{name}")
                    if held:
                        page.wait_for(held)
                        host.deliver = lambda request, body: None
                    work(page)

            await asyncio.to_thread(drive)

    run(serve())


def picture(page: Browser, **settings: object) -> str:
    """Picture with these settings."""
    page.evaluate(f"{ELEMENT}.controlPanel.set({json.dumps(settings)})")
    return str(page.resolve(f"{ELEMENT}.picture({json.dumps(CAMERA)})"))


def test_preview_stays_until_the_first_sorted_frame() -> None:
    """Depth sorting may take any time."""

    def work(page: Browser) -> None:
        page.wait_for(f"{ELEMENT}?.view && !!{ELEMENT}.shadowRoot.querySelector('.first.shown')")
        page.wait_for(f"!{ELEMENT}.shadowRoot.querySelector('.first.shown')")
        assert page.evaluate("window.sorted") is True

    on_page("late", encode_splats(ball(), SMALL, quality=Quality(10.0)), work)


def test_switching_concealers_renders_each_correctly() -> None:
    stream = encode_splats(ball(), SMALL, quality=Quality(10.0))
    names = ("drop", *concealers_of(stream))

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)
        first = {name: picture(page, lossRate=0.4, concealer=name) for name in names}
        first["whole"] = picture(page, lossRate=0)
        assert len(set(first.values())) == len(first), "two of them draw the same"
        for name in (*names, *reversed(names)):
            for other in names:  # requested and then cancelled
                page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.4, concealer: '{other}'}})")
            assert picture(page, concealer=name) == first[name], name
            assert picture(page, lossRate=0) == first["whole"]

    on_page("patient", stream, work)


def test_tiles_are_uploaded_incrementally_and_gains_only_where_changed() -> None:
    splats = ball(40_000, degree=3)
    dots = replace(splats, scales=splats.scales * 0.15)  # Gaussians of many pixels take software renderers seconds
    stream = encode_levels(SplatScene(dots), Packetization(block_size=3000, lanes=4))

    def work(page: Browser) -> None:
        page.patience = 200.0  # a busy machine with a software renderer
        page.wait_for(WHOLE)
        before = page.evaluate(f"{ELEMENT}.saveView()")
        whole = picture(page)
        assert page.evaluate(f"[{ELEMENT}.view.fixed, {ELEMENT}.saveView()]") == [None, before]
        page.evaluate(f"{ELEMENT}.view.fix({json.dumps(CAMERA)})")  # the camera of all pictures below
        assert picture(page) == whole
        opening = page.evaluate("uploaded")
        assert opening["all"] > 5e6
        assert opening["most"] < 4.7e6
        page.evaluate("uploaded.all = uploaded.most = 0")
        assert picture(page, concealer="drop") == whole
        assert page.evaluate("uploaded.all") == 0, "what did not change was uploaded"
        assert picture(page, lossRate=0.4) != whole
        assert 0 < page.evaluate("uploaded.all") < opening["all"] / 2
        assert page.evaluate("uploaded.most") < 4.7e6
        assert picture(page, lossRate=0) == whole

    on_page("counted", stream, work)


def test_page_does_not_wait_for_shaders_and_draws_all_once_they_are_linked() -> None:
    stream, pictures = encode_splats(ball(), SMALL, quality=Quality(10.0)), list[str]()

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)
        pictures.append(picture(page))

    def work_while_linking(page: Browser) -> None:
        work(page)
        assert page.evaluate("window.unlinked") > 0
        assert page.evaluate("window.waited") == 0

    on_page("patient", stream, work)
    on_page("linking", stream, work_while_linking)
    assert pictures[0] == pictures[1]


def test_canvas_is_resized_after_the_gpu_has_drawn() -> None:
    """Resizing clears the canvas and waits for pending GPU work."""

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)
        canvas, draw = f"{ELEMENT}.view.canvas", f"{ELEMENT}.view.touch()"
        page.evaluate(f"{draw}; requestAnimationFrame(() => (window.busy = true))")
        page.wait_for("window.busy")
        page.evaluate(f"{ELEMENT}.style.height = '120px'")
        page.wait_for(f"{canvas}.clientHeight < 130")
        page.resolve(
            "new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(go, 200))))"
        )
        assert page.evaluate(f"{canvas}.height > {canvas}.clientHeight")
        page.evaluate("window.busy = false")
        page.wait_for(f"{canvas}.height === {canvas}.clientHeight")

    on_page("busy", encode_splats(ball(), SMALL, quality=Quality(10.0)), work)


def test_replaced_rows_are_never_drawn_in_a_stale_order() -> None:
    """Rows of a clip are replaced: pictures of the same Gaussians are equal in any row order, at all times."""
    count = 40

    def halves(columns: np.ndarray) -> list[int]:
        return columns.astype(np.float16).view(np.uint16).ravel().tolist()

    def orders(viewmat: np.ndarray) -> list[dict[str, list]]:
        """Gaussians one behind the other, in two random orders."""
        rng, ones = np.random.default_rng(2), np.ones((count, 1))
        seen = np.hstack([rng.uniform(-0.1, 0.1, (count, 2)), np.linspace(-0.3, 0.3, count)[:, None]])
        centers = np.hstack([seen @ viewmat[:3, :3], ones])
        colours = np.hstack([rng.uniform(0, 1, (count, 3)), ones * 0.9])
        return [
            {
                "centers": centers[row].ravel().tolist(), "colours": halves(colours[row]),
                "scales": halves(np.full((count, 4), 0.1)), "rotations": halves(np.eye(4)[np.zeros(count, int)]),
                "opacities": [0.9] * count,
            }
            for row in (rng.permutation(count), rng.permutation(count))
        ]  # fmt: skip

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)
        given = json.dumps(orders(np.array(page.evaluate(f"{ELEMENT}.view.camera.viewmat"))))
        pictures = page.resolve(TURNS.replace("GIVEN", given).replace("COUNT", str(count)))
        assert len(pictures) > 15
        assert len(set(pictures)) == 1

    on_page("patient", encode_splats(ball(degree=0), SMALL, quality=Quality(10.0)), work)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *((name, "This device cannot draw the scene: too little memory.") for name in ("gpu", "process", "frame")),
        ("defect", "Drawing failed: a defect"),
    ],
)
def test_failure_to_draw_is_one_error_and_the_scene_is_painted(name: str, reason: str) -> None:
    """No promise is rejected without a handler, and a page that waits for a picture gets the reason."""

    def work(page: Browser) -> None:
        assert page.wait_for(f"{ELEMENT}?.status?.failed") == reason
        page.wait_for(f"{ELEMENT}.status.verified")
        assert page.evaluate("[heard, attempts, retries]") == [[f"failed: {reason}"], 1, 0]
        assert page.evaluate(f"[!{ELEMENT}.view, !!{ELEMENT}.shadowRoot.querySelector('.first.shown')]") == [True, True]
        picture = f"{ELEMENT}.picture({json.dumps(CAMERA)}).catch(({{message}}) => message)"
        assert page.resolve(picture) == reason

    on_page(f"{name}-100", encode_splats(ball(), SMALL, quality=Quality(10.0)), work)


@pytest.mark.parametrize("name", ["gpu", "process"])
def test_levels_are_drawn_again_with_fewer_gaussians_after_too_little_memory(name: str) -> None:
    stream = encode_levels(SplatScene(ball(8000)), Packetization(block_size=1000, lanes=4))

    def work(page: Browser) -> None:
        page.wait_for(f"attempts === 2 && {WHOLE}")
        assert page.evaluate("[heard, retries]") == [[], 1]
        assert page.evaluate(f"{ELEMENT}.status.failed") is None

    on_page(f"{name}-1", stream, work)


def test_failure_to_draw_before_the_first_tiles_is_not_final() -> None:
    """The picture area alone was too large for the memory at that time."""
    stream = encode_levels(SplatScene(ball(3000)), Packetization(block_size=1000, lanes=4))

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)
        assert page.evaluate("heard") == []

    on_page("gpu-1", stream, work, held="attempts === 1")


def test_missing_webgl_is_one_error_and_is_over_once_it_works() -> None:
    def work(page: Browser) -> None:
        def scroll(top: int, expected: str) -> None:
            page.evaluate(f"scrollTo(0, {top})")
            page.wait_for(expected)

        reason = page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.status.failed")
        assert reason.startswith("This browser has no WebGL 2")
        watch = "new IntersectionObserver((all) => (window.seen = all.at(-1).isIntersecting))"
        page.evaluate(f"void {watch}.observe({ELEMENT})")
        for attempts in (2, 3):
            scroll(2000, "window.seen === false")
            scroll(0, f"attempts === {attempts}")
        page.evaluate("window.works = true")
        scroll(2000, "window.seen === false")
        scroll(0, f"{ELEMENT}.view?.shows")
        page.wait_for(f"{ELEMENT}.status.failed === null")
        assert page.evaluate("heard") == [f"failed: {reason}"]

    on_page("without", encode_splats(ball(), SMALL, quality=Quality(10.0)), work)


def test_picture_that_is_too_large_rejects_and_the_page_draws_on() -> None:
    """A scene of the same memory is drawn again in the size of the element."""

    def work(page: Browser) -> None:
        page.wait_for(WHOLE)

        def picture_of(height: int) -> str:
            camera = json.dumps(CAMERA | {"height": height})
            return str(page.resolve(f"{ELEMENT}.picture({camera}).catch(({{message}}) => message)"))

        assert picture_of(200_000).startswith("a picture of this device has at most")
        assert picture_of(2000) == "This device cannot draw the scene: too little memory."
        assert picture_of(180).startswith("data:image/png")
        page.wait_for(f"{ELEMENT}.view?.shows")
        assert page.evaluate(f"[heard, {ELEMENT}.status.failed]") == [[], None]

    on_page("picture", encode_splats(ball(), SMALL, quality=Quality(10.0)), work)
