"""Scene in a headset (WebXR), with a fake `navigator.xr` that has two eyes and draws into the canvas."""

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

from explicit import encode_splats
from splatwire.codec.gaussians.quality import Quality
from splatwire.transport.http.pack import pack_stream
from transport.chromium import Browser, executable, isolated_page
from web.node import lacking
from web.pictures import ELEMENT
from web.test_page import SMALL, ball
from web.test_page_visitors import opened

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
ROOT = f"{ELEMENT}.shadowRoot"
BUTTON = f"{ROOT}.querySelector('button[title=\"show in a headset\"]')"
USE = f"{ROOT}.querySelector('.bar').dispatchEvent(new PointerEvent('pointerenter'))"
"""Moves the pointer to the controls; only then the page looks for a headset."""
SIZE = 240
"""Width and height of the picture of one eye, pixels; its field of view is 90 degrees."""
DISTANCE, TARGET_M = 3.0, 2.0
"""Distance from the page's camera to its target, world units, and the same distance in the headset, metres."""
EYES_M = (-0.2, 0.2)
"""Horizontal positions of the eyes in the head, exaggerated, metres."""
POSITION_M, ANGLE = (0.1, -0.2, 0.3), 0.3
"""Position of the head relative to the start of the session, metres, and its rotation to the left, radians."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Change between cameras that look along z with y down (OpenCV) and along -z with y up (WebXR)."""


def head(x: float = 0.0) -> np.ndarray:
    """Pose of the head, or of an eye at this horizontal position: matrix (4, 4) to the session's space, metres."""
    cosine, sine = np.cos(ANGLE), np.sin(ANGLE)
    pose = np.array([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1]])
    pose[:3, 3] = POSITION_M + pose[:3, 0] * x
    return pose


def columns(matrix: np.ndarray) -> str:
    """The elements of a matrix as WebXR orders them."""
    return json.dumps(matrix.T.ravel().tolist())


FAKE = f"""
const SIZE = {SIZE}, near = 0.01, far = 2000;
const projectionMatrix = new Float32Array([
  1, 0, 0, 0, 0, 1, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
const view = (eye, matrix, inverse) => ({{
  eye, projectionMatrix,
  transform: {{ matrix: new Float32Array(matrix), inverse: {{ matrix: new Float32Array(inverse) }} }} }});
const views = [
  view("left", {columns(head(EYES_M[0]))}, {columns(np.linalg.inv(head(EYES_M[0])))}),
  view("right", {columns(head(EYES_M[1]))}, {columns(np.linalg.inv(head(EYES_M[1])))})];
const position = {{ x: {POSITION_M[0]}, y: {POSITION_M[1]}, z: {POSITION_M[2]} }};
const orientation = {{ x: 0, y: {np.sin(ANGLE / 2)}, z: 0, w: {np.cos(ANGLE / 2)} }};
window.XRWebGLBinding = undefined;
window.XRWebGLLayer = class {{
  framebuffer = null;
  framebufferWidth = 2 * SIZE;
  framebufferHeight = SIZE;
  getViewport({{ eye }}) {{ return {{ x: eye === "left" ? 0 : SIZE, y: 0, width: SIZE, height: SIZE }}; }}
}};
class Session extends EventTarget {{
  renderState = {{}};
  updateRenderState(state) {{ Object.assign(this.renderState, state); }}
  async requestReferenceSpace() {{ return {{}}; }}
  requestAnimationFrame(work) {{
    const frame = {{ session: this, getViewerPose: () => ({{ transform: {{ position, orientation }}, views }}) }};
    return setTimeout(() => {{
      work(performance.now(), frame);
      window.eyes = document.querySelector("splat-wire").view?.canvas.toDataURL();
      window.frames_drawn = (window.frames_drawn ?? 0) + 1;
    }}, 30);
  }}
  cancelAnimationFrame(number) {{ clearTimeout(number); }}
  async end() {{
    this.ended = true;
    this.dispatchEvent(new Event("end"));
  }}
}}
const xr = Object.assign(new EventTarget(), {{
  isSessionSupported: async (kind) => kind === "immersive-vr",
  requestSession: async () => {{
    if (window.refuses) throw new Error("it is off");
    return (window.session = new Session());
  }},
}});
Object.defineProperty(navigator, "xr", {{ value: xr }});
"""
FULL = """
const {getError} = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.getError = function () {
  return window.isFull ? this.OUT_OF_MEMORY : getError.call(this);
};"""
"""WebGL refuses memory while `isFull` is true."""


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> str:
    if reason := lacking():
        pytest.skip(reason)
    path = tmp_path_factory.mktemp("headset") / "ball.html"
    path.write_bytes(pack_stream(encode_splats(ball(), SMALL, quality=Quality(10.0)), "a ball"))
    return path.as_uri()


def image_of(url: str) -> np.ndarray:
    picture = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")
    return np.asarray(picture, dtype=np.float32) / 255


def psnr(picture: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two pictures, dB."""
    return float(-10 * np.log10(max(np.mean((picture - reference) ** 2), 1e-12)))


def viewmat_of(page: Browser) -> np.ndarray:
    """The page's current world-to-camera matrix, (3, 4)."""
    return np.array(json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.view.camera.viewmat)")))


def moved(viewmat: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """World-to-camera matrix (3, 4) of a pose in the headset, of a session that began with the page's camera."""
    scale = np.diag([*[DISTANCE / TARGET_M] * 3, 1.0])
    to_world = np.linalg.inv(np.vstack([viewmat, [0, 0, 0, 1]])) @ OPENGL @ scale @ pose @ OPENGL
    to_world[:3, :3] *= TARGET_M / DISTANCE
    return np.linalg.inv(to_world)[:3]


def picture_of(page: Browser, viewmat: np.ndarray) -> np.ndarray:
    """Picture that the page draws with the camera of one eye."""
    camera = {"viewmat": viewmat.tolist(), "focal": SIZE / 2, "height": SIZE, "width": SIZE}
    url = page.resolve(f"{ELEMENT}.picture({json.dumps(camera)})")
    return image_of(url)


def last_picture(page: Browser) -> np.ndarray:
    """Picture of both eyes, once it no longer changes."""
    last, frames = "", 0
    while last != (last := page.evaluate("window.eyes ?? 'none'")) or frames < 20:
        frames = page.evaluate("window.frames_drawn ?? 0") + 5
        page.wait_for(f"window.frames_drawn > {frames}")
        page.resolve(f"{ELEMENT}.view.sorted()")
    return image_of(last)


def enter(page: Browser) -> None:
    page.evaluate(USE)
    page.wait_for(f"Boolean({BUTTON})")
    page.evaluate(f"{BUTTON}.click()")


def test_both_eyes_see_what_the_page_draws_from_their_positions(packed: str) -> None:
    with isolated_page() as page:
        page.prepare(FAKE)
        opened(page, packed)
        page.resolve(f"{ELEMENT}.flyTo('{DISTANCE} 0 0 0 0 0 0 1 0', 0)")
        page.resolve(f"{ELEMENT}.view.sorted()")
        viewmat = viewmat_of(page)
        wanted = [picture_of(page, moved(viewmat, head(x))) for x in EYES_M]
        page.resolve(f"{ELEMENT}.view.sorted()")
        before = page.evaluate(f"{ELEMENT}.view.canvas.width")
        enter(page)
        seen = last_picture(page)
        assert seen.shape == (SIZE, 2 * SIZE, 3)
        assert np.allclose(viewmat_of(page), moved(viewmat, head()), atol=1e-4)
        left, right = seen[:, :SIZE], seen[:, SIZE:]
        assert psnr(left, wanted[0]) > 30
        assert psnr(right, wanted[1]) > 30
        assert psnr(left, wanted[1]) < 24, "both eyes see the same"
        page.resolve("window.session.end()")
        page.wait_for(f"{ELEMENT}.view.canvas.width === {before}")
        assert np.allclose(viewmat_of(page), viewmat, atol=1e-4)
        assert psnr(picture_of(page, moved(viewmat, head(EYES_M[0]))), wanted[0]) > 40


def test_too_little_memory_in_a_headset_ends_the_session_with_one_error(packed: str) -> None:
    """The page shows the scene again."""
    with isolated_page() as page:
        page.prepare(FAKE)
        page.prepare(FULL)
        opened(page, packed)
        page.evaluate(f"window.failures = []; {ELEMENT}.addEventListener('error', (event) => failures.push(event))")
        enter(page)
        page.wait_for("window.frames_drawn > 3")
        page.evaluate(f"window.isFull = true; {ELEMENT}.view.antialias(true)")
        reason = page.wait_for(f"{ELEMENT}.status.failed")
        assert reason == "This device cannot draw the scene: too little memory."
        page.wait_for(f"Boolean({ROOT}.querySelector('.first.shown'))")
        assert page.evaluate(f"[failures.length, session.ended, {ELEMENT}.view]") == [1, True, None]


def test_a_headset_that_refuses_gives_a_message_and_the_page_continues(packed: str) -> None:
    with isolated_page() as page:
        page.prepare(FAKE)
        opened(page, packed)
        viewmat = viewmat_of(page)
        before = picture_of(page, viewmat)
        assert before.max() > 0.2
        page.evaluate("window.refuses = true")
        enter(page)
        page.wait_for(f"{ROOT}.querySelector('.state').textContent === 'No headset: it is off'")
        assert psnr(picture_of(page, viewmat), before) > 40


def test_button_appears_for_visitors_who_only_touch_the_scene(packed: str) -> None:
    """A press of a mouse on the scene does not look for a headset, so that Chromium may restore the page later."""
    with isolated_page() as page:
        page.prepare(FAKE)
        page.emulate(800, 600)
        opened(page, packed)
        page.evaluate("window.searches = 0; xr.isSessionSupported = async () => { searches++; return true; }; 0")
        page.drag((200, 200), (300, 200))
        assert page.evaluate("searches") == 0
        page.emulate(800, 600, touch=True)
        for x in (200.0, 300.0):
            page.touch([(x, 200.0)])
        page.wait_for(f"Boolean({BUTTON}) && {BUTTON}.checkVisibility()")
        assert page.evaluate("searches") == 1


def test_without_a_headset_there_is_no_button(packed: str) -> None:
    with isolated_page() as page:
        opened(page, packed)
        page.evaluate(USE)
        page.resolve("navigator.xr?.isSessionSupported('immersive-vr')")
        assert not page.evaluate(f"Boolean({BUTTON})")
