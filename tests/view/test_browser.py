"""The page, end to end: headless Chromium opens it, a person's hands move it, and the picture follows."""

import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import encode_scene
from splatwire.packets import Packetization
from splatwire.scene import Cameras
from splatwire.view.looks import first_look
from splatwire.view.model import LAYERS, Frame, Settings, Viewer
from splatwire.view.sources import FileSource
from view.chromium import Chromium, find_chromium

pytest.importorskip("viser", reason="the viewer's extra is not installed")
if find_chromium() is None:
    pytest.skip("no Chromium here; on Debian: apt-get install chromium", allow_module_level=True)

import viser

from splatwire.view.server import ViewerServer

PATIENCE_S = 60.0


class Recorder(Viewer):
    """Remembers where it drew from."""

    def __init__(self, source: FileSource) -> None:
        super().__init__(source)
        self.places: list[np.ndarray] = []

    def frame(self, settings: Settings, cameras: Cameras, *, score: bool = True) -> Frame:
        self.places.append(cameras.centers[0].numpy())
        return super().frame(settings, cameras, score=score)


@pytest.fixture(scope="module")
def server() -> Iterator[ViewerServer]:
    scene = tiny_scene(seed=2, num_anchors=600)
    stream = encode_scene(scene, Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=700))
    first = first_look(scene.anchors.positions, tiny_cameras(distance=4.0))
    names, settings = ("drop", "grow", "idw"), Settings(loss=0.5, concealer="grow")
    server = ViewerServer(Recorder(FileSource(stream)), settings, first, names, port=0, still_height=160, play_s=2.0)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.stop()
    thread.join(10)
    assert not thread.is_alive()


@pytest.fixture(scope="module")
def page(server, tmp_path_factory) -> Iterator[Chromium]:
    browser = Chromium(find_chromium(), tmp_path_factory.mktemp("profile"))
    try:
        browser.open(server.url, "Concealer")
        yield browser
    finally:
        browser.close()


def picture(page: Chromium) -> np.ndarray:
    """The part of the page that neither the panel nor a notice covers."""
    return page.screenshot()[170:, :640]


def settled(page: Chromium, other_than: np.ndarray | None = None) -> np.ndarray:
    """Waits for a picture that stays, and that is not another one."""
    end, before = time.monotonic() + PATIENCE_S, picture(page)
    while time.monotonic() < end:
        time.sleep(0.6)
        now = picture(page)
        there = now.std() > 8 and (other_than is None or not np.array_equal(now, other_than))
        if there and np.array_equal(now, before):
            return now
        before = now
    raise AssertionError("no new picture came")


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.1)


def place(page: Chromium, script: str) -> tuple[float, float]:
    """Middle of an element, once it is visible."""
    js = f"(() => {{ const e = {script}; if (!e) return null; const r = e.getBoundingClientRect();" \
         "return r.width ? [r.x + r.width / 2, r.y + r.height / 2] : null; })()"  # fmt: skip
    wait_for(lambda: page.evaluate(js) is not None)
    time.sleep(0.3)  # menus slide in
    x, y = page.evaluate(js)
    return x, y


def choose(page: Chromium, number: int, option: str) -> None:
    """Chooses from one of the visible lists."""
    boxes = "[...document.querySelectorAll('input[role=combobox]')].filter(e => e.offsetParent)"
    page.click(*place(page, f"{boxes}[{number}]"))
    found = f"[...document.querySelectorAll('[role=option]')].find(e => e.innerText.trim() === '{option}')"
    page.click(*place(page, found))


def test_the_first_picture_is_drawn_from_where_the_view_starts(server, page):
    settled(page)
    for place in server._viewer.places:
        np.testing.assert_allclose(place, server._first.position, atol=1e-3)


def test_the_page_follows_a_persons_hands(server, page):
    first = settled(page)
    assert "PSNR" in page.evaluate("document.body.innerText")

    choose(page, 0, "drop")
    wait_for(lambda: server.settings.concealer == "drop")
    dropped = settled(page, other_than=first)

    thumb = place(page, "[...document.querySelectorAll('[role=slider]')].filter(e => e.offsetParent)[0]")
    page.drag(thumb, (thumb[0] - 45, thumb[1]))
    wait_for(lambda: server.settings.loss < 0.4)
    mended = settled(page, other_than=dropped)

    choose(page, 1, LAYERS[1])
    lossless = settled(page, other_than=mended)
    distance = [float(np.abs(p.astype(float) - lossless).mean()) for p in (dropped, mended)]
    assert distance[0] > distance[1] > 0

    page.drag((300, 300), (380, 330))
    settled(page, other_than=lossless)


def test_the_transfer_is_played(server, page):
    choose(page, 1, LAYERS[0])
    play = "[...document.querySelectorAll('label')].find(e => e.innerText === 'Play')"
    box = f"document.getElementById({play}.htmlFor) || document.querySelectorAll('input[type=checkbox]:last-of-type')"
    page.click(*place(page, box))
    wait_for(lambda: server.settings.progress < 0.9)
    early = server.settings.progress
    wait_for(lambda: server.settings.progress > early)
    wait_for(lambda: server.settings.progress == 1.0 and not server.playing)


def test_nobody_gets_lost(server, page):
    """However a person zooms and turns: where there was no camera there is nothing to see."""
    first, limits = server._first, server._first.limits
    for turn in (200, -200):
        for _ in range(60):
            page.call("Input.dispatchMouseEvent", type="mouseWheel", x=300, y=400, deltaX=0, deltaY=turn)
    for _ in range(3):
        page.drag((500, 200), (200, 500))
    time.sleep(1.0)
    handle = next(iter(server._clients.values())).handle
    wait_for(lambda: np.allclose(server._viewer.places[-1], handle.camera.position, atol=1e-3))
    for place in server._viewer.places:
        allowed, target = limits.within(tuple(place.tolist()), first.look_at)
        np.testing.assert_allclose(allowed, place, atol=0.01 * limits.farthest)
        assert target == pytest.approx(first.look_at)
    assert np.linalg.norm(np.ptp(server._viewer.places, axis=0)) > limits.nearest  # it did move


def test_another_page_gets_no_connection(server, page):
    page.call("Page.navigate", url="about:blank")
    time.sleep(0.5)
    address = server.url.replace("http", "ws")
    script = f"new Promise(r => {{ const s = new WebSocket('{address}', 'viser-v{viser.__version__}');" \
             "s.onopen = () => r('open'); s.onerror = () => r('refused'); })"  # fmt: skip
    assert page.evaluate(script) == "refused"


def test_nothing_but_this_machine_can_connect(server):
    assert server.url.startswith("http://127.0.0.1:")
