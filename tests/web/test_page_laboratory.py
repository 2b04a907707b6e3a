"""The laboratory compares the current picture: not an earlier one, and with the losses of every tile."""

import asyncio
import json
from collections.abc import Callable

import pytest

from codec.gaussians.test_gaussians import some_splats
from explicit import encode_splats
from scenes import tiny_cameras
from splatwire.bitstream import Packetization, stream_to_bytes
from splatwire.codec.gaussians.quality import Quality
from splatwire.lod import encode_levels
from splatwire.types import SplatScene
from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
TAG = '<splat-wire src="{}" panel="open" style="width: 600px; height: 400px"></splat-wire>'
PAGES = {
    name: f'<script type="module" src="splatwire.js"></script>{TAG.format(f"{name}.swz")}'
    for name in ("ball", "levels", "part")
}
OVER = f"{ELEMENT}.shadowRoot.querySelector('.over').classList.contains('shown')"
CAMERA = {"viewmat": tiny_cameras(1, 64, 48).viewmats[0].tolist(), "focal": 60.0, "width": 64, "height": 48}
SPY = f"""(() => {{
  const {{ view }} = {ELEMENT}, plain = view.setGains;
  window.gains = [];
  view.setGains = function (given) {{ gains.push(given && given.length); return plain.call(this, given); }};
}})()"""
"""Records the sizes of all gains, null for a picture without losses."""


@pytest.fixture(scope="module")
def streams() -> dict[str, bytes]:
    plain = encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))
    levels = encode_levels(SplatScene(some_splats(6000)), Packetization(block_size=400, lanes=2))
    scenes = {"ball.swz": plain, "levels.swz": levels, "part.swz": plain.with_packets(plain.packets[::2])}
    return {name: stream_to_bytes(scene) for name, scene in scenes.items()}


def driven(streams: dict[str, bytes], name: str, work: Callable[[Browser], None]) -> None:
    async def serve() -> None:
        async with hosting(PAGES, streams) as host:

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}{name}")
                    page.wait_for(
                        f"{ELEMENT}?.status?.finished !== null && {ELEMENT}?.status?.gaussians && {ELEMENT}.view"
                    )
                    work(page)

            await asyncio.to_thread(drive)

    run(serve())


@pytest.mark.parametrize(("width", "height"), [(400, 300), (240, 400)])
def test_laboratory_of_a_narrow_element_is_below_the_scene(streams: dict[str, bytes], width: int, height: int) -> None:
    """The window is wide; the scene keeps half of the height."""
    sizes = f"""['.scene', '.laboratory'].flatMap((one) => {{
      const {{ clientWidth, clientHeight }} = {ELEMENT}.shadowRoot.querySelector(one);
      return [clientWidth, clientHeight];
    }})"""

    def work(page: Browser) -> None:
        page.wait_for(f"{ELEMENT}.status.verified")
        page.evaluate(f"{ELEMENT}.style.cssText = 'width: {width}px; height: {height}px'")
        scene_width, scene_height, side_width, side_height = page.evaluate(sizes)
        assert scene_width == side_width == width
        assert scene_height >= height / 2
        assert side_height >= height / 4
        assert scene_height + side_height <= height

    driven(streams, "ball", work)


def test_difference_disappears_once_its_picture_changes(streams: dict[str, bytes]) -> None:
    changes = (
        f"{ELEMENT}.view.orbit.focus({{x: 300, y: 180}})",
        f"{ELEMENT}.setAttribute('viewpoint', '0 0 -6 0 0 0 0 -1 0')",
        f"{ELEMENT}.setAttribute('up', 'z')",
        f"{ELEMENT}.style.width = '500px'",
    )
    watch = f"""new MutationObserver((changes) => {{ window.hidden ||= !{OVER}; }}).observe(
      {ELEMENT}.shadowRoot.querySelector('.over'), {{ attributes: true }})"""

    def work(page: Browser) -> None:
        page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.5, show: 'difference'}}); {watch}")
        for change in changes:
            page.wait_for(OVER)
            page.evaluate(f"window.hidden = false; {change}; 0")
            page.wait_for("window.hidden")

    driven(streams, "ball", work)


def test_psnr_of_another_picture_is_not_shown(streams: dict[str, bytes]) -> None:
    """From the change of a setting or the view to the next comparison, the panel says so."""
    row = f"[...{ELEMENT}.shadowRoot.querySelectorAll('dt')].find((dt) => dt.textContent === 'PSNR')?.nextSibling"
    now = f"{row}?.textContent"
    drop = f"{ELEMENT}.controlPanel.set({{{{lossRate: {{}}}}}})"

    def work(page: Browser) -> None:
        page.wait_for(f"{now} === 'no loss'")
        for change in (drop.format(0.5), drop.format(0.8), f"{ELEMENT}.view.orbit.rotate(1, 0)"):
            assert page.evaluate(f"(() => {{ {change}; return {now}; }})()") == "comparing ...", change
            page.wait_for(f"/^[0-9.]+ dB$/.test({now})")
        page.evaluate(f"{ELEMENT}.controlPanel.set({{show: 'lossless'}})")
        page.wait_for(f"{now} === 'not compared'")
        page.evaluate(drop.format(0))
        page.wait_for(f"{now} === 'no loss'")

    driven(streams, "ball", work)


def test_figures_of_an_incomplete_scene_name_their_reference(streams: dict[str, bytes]) -> None:
    rows = f"[...{ELEMENT}.shadowRoot.querySelectorAll('dt')]"
    psnr_row = f"{rows}.find((dt) => dt.textContent === 'PSNR').nextSibling.textContent"

    def work(page: Browser) -> None:
        assert page.evaluate(f"{ELEMENT}.status.complete") is False
        page.evaluate(SPY)
        page.evaluate(f"{ELEMENT}.controlPanel.set({{concealer: 'grow'}})")
        page.wait_for("gains.includes(null)")  # the picture of what arrived
        page.resolve(f"{ELEMENT}.picture({json.dumps(CAMERA)})")  # after the comparison
        page.wait_for(f"{psnr_row} === 'of what arrived: nothing dropped'")
        page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.5}})")
        page.wait_for(f"/^of what arrived: [0-9.]+ dB$/.test({psnr_row})")

    driven(streams, "part", work)


def test_picture_without_losses_stays_if_it_is_chosen_during_a_comparison(streams: dict[str, bytes]) -> None:
    hold = f"""(() => {{
      const {{ view }} = {ELEMENT}, plain = view.frame;
      window.held = 0;
      const gate = new Promise((open) => (window.open_ = open));
      view.frame = function () {{ held++; return gate.then(() => plain.call(this)); }};
    }})()"""

    def work(page: Browser) -> None:
        page.evaluate(SPY)
        page.evaluate(f"{hold}; {ELEMENT}.controlPanel.set({{lossRate: 0.5}})")
        page.wait_for("held === 1")  # the comparison waits for its picture without losses
        page.evaluate(f"gains.length = 0; {ELEMENT}.controlPanel.set({{show: 'lossless'}})")
        page.wait_for("gains.length > 0")
        page.evaluate("open_()")
        page.resolve(f"{ELEMENT}.picture({json.dumps(CAMERA)})")  # after the comparison
        assert page.evaluate("gains.at(-1)") is None

    driven(streams, "ball", work)


def test_tiles_of_a_new_view_have_the_chosen_losses(streams: dict[str, bytes]) -> None:
    def work(page: Browser) -> None:
        page.wait_for(f"{ELEMENT}.status.verified")
        page.evaluate(f"{ELEMENT}.setAttribute('viewpoint', '0 0 -900 0 0 0 0 -1 0')")
        page.wait_for(f"{ELEMENT}.view.count < 3000")
        page.evaluate(SPY)
        page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.5}})")
        page.wait_for(f"gains.includes(2 * {ELEMENT}.view.count)")
        page.evaluate(f"{ELEMENT}.setAttribute('viewpoint', '0 0 -30 0 0 0 0 -1 0')")
        page.wait_for(f"{ELEMENT}.view.count > 4000 && gains.includes(2 * {ELEMENT}.view.count)")

    driven(streams, "levels", work)
