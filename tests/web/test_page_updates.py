"""A page swaps updates in: without a reload, without another picture in between, and with uploads of what is new."""

import asyncio
import base64
import os
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from explicit import encode_splats
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.codec import apply_update, encode_update
from splatwire.codec.update.section import manifest_digest, update_name
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer
from transport.chromium import executable, isolated_page
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
COUNT = """window.uploaded = 0; window.updates = [];
const upload = WebGL2RenderingContext.prototype.texSubImage2D;
WebGL2RenderingContext.prototype.texSubImage2D = function (...given) {
  window.uploaded += given[8]?.byteLength ?? 0;
  return upload.apply(this, given);
};
for (const kind of ["update", "updatemissed"])
  document.addEventListener(kind, ({ detail }) => window.updates.push({ kind, ...detail }), true);"""
SLOW_SORTER = """window.Worker = class extends Worker {
  addEventListener(kind, listener, ...given) {
    super.addEventListener(kind, (event) => setTimeout(() => listener(event), 200), ...given);
  }
};"""
"""Depth orders arrive long after the Gaussians, as on a busy machine: many frames are drawn before."""
READY = f"{ELEMENT}?.status?.verified && {ELEMENT}.view?.shows"
RECORD = f"""window.pictures = new Set();
window.recording = (async () => {{
  const {{ view }} = {ELEMENT}, known = window.updates.length;
  do {{
    await view.frame();
    window.pictures.add(view.canvas.toDataURL());
  }} while (window.updates.length === known);
  await view.frame();
  return [...window.pictures, view.canvas.toDataURL()];
}})();"""
"""Different pictures from now until the next update is on the screen, in order, and the last one."""
REDRAWN = f"""(async () => {{
  const {{ view }} = {ELEMENT}, sorted = view.sorted();
  view.fix(null);
  await sorted;
  await view.frame();
  return view.canvas.toDataURL();
}})()"""
"""The picture after another copy and depth sort of all Gaussians."""
DROPPED = f"""[...{ELEMENT}.shadowRoot.querySelectorAll('dt')]
  .find((dt) => dt.textContent === 'dropped on purpose')?.nextSibling.textContent"""


def scenes() -> list[SceneStream]:
    """A ball, the same with a part removed and another one moved and brighter, the ball again, and less of it."""
    splats = ball(degree=1)
    base = encode_splats(splats, SMALL)
    keep = splats.means[:, 0] < 0.6
    edited = splats.select(np.flatnonzero(keep))
    top = edited.means[:, 1] > 0.5
    means, sh = edited.means.copy(), edited.sh.copy()
    means[top, 1] += np.float32(0.4)
    sh[top, 0] += np.float32(1.5)
    edited = replace(edited, means=means, sh=sh)
    first = encode_update(base, edited)
    middle = apply_update(base, first)
    second = encode_update(middle, splats)
    return [base, first, second, encode_update(apply_update(middle, second), splats.select(np.arange(100, 1500)))]


def keep_picture(name: str, data: str) -> None:
    """Writes a picture into the folder `SPLATWIRE_PICTURES`, if that is set, to look at it."""
    if folder := os.environ.get("SPLATWIRE_PICTURES"):
        (Path(folder) / f"{name}.png").write_bytes(base64.b64decode(data.partition(",")[2]))


def test_pages_swap_updates_in_without_another_picture_in_between() -> None:
    base, first, second, third = scenes()
    middle = apply_update(base, first)

    async def work() -> None:
        async with AsyncExitStack() as stack:
            content = PageContent({"ball": stream_to_bytes(base)}, attributes={"updates": ""})
            pages, updates = await stack.enter_async_context(PageServer(content)), dict[str, bytes]()
            with isolated_page() as page:

                async def call(method: str, *given: object) -> object:
                    return await asyncio.to_thread(getattr(page, method), *given)

                async def swap(state: SceneStream, update: SceneStream, **damaged: bytes) -> list[str]:
                    name = update_name(manifest_digest(state.manifest))
                    await call("evaluate", RECORD)
                    await call("wait_for", "window.pictures.size")
                    updates[name] = damaged.get("data", stream_to_bytes(update))
                    pages.content = replace(content, updates=dict(updates))
                    return await call("resolve", "window.recording")

                await call("prepare", COUNT + SLOW_SORTER)
                await call("open", pages.url)
                await call("wait_for", READY)
                whole = await call("evaluate", "window.uploaded")
                # a damaged update changes nothing, and is requested again
                bad = bytearray(stream_to_bytes(first))
                bad[-5] ^= 1
                found = await swap(base, first, data=bytes(bad))
                assert len(set(found)) == 1
                assert (await call("evaluate", "window.updates[0].kind")) == "updatemissed"
                before = found[-1]
                await call("evaluate", "window.uploaded = 0")
                found = await swap(base, first)
                after = found[-1]
                keep_picture("before", before)
                keep_picture("after", after)
                assert [before, after] == list(dict.fromkeys(found))
                new, removed = first.manifest.num_elements, 1500 - middle.manifest.num_elements
                detail = {"kind": "update", "added": new, "removed": removed + new, "gaussians": 1500 - removed}
                assert await call("evaluate", "window.updates[1]") == detail
                assert await call("evaluate", f"{ELEMENT}.status.gaussians") == 1500 - removed
                assert 0 < await call("evaluate", "window.uploaded") < whole
                found = await swap(middle, second)
                assert len(set(found)) == 2
                # an update without new Gaussians is drawn, and drawing everything again changes nothing
                assert third.manifest.num_elements == 0
                found = await swap(apply_update(middle, second), third)
                assert len(set(found)) == 2
                assert (await call("resolve", REDRAWN)) == found[-1]
                # the concealers and losses of the panel do not bring removed Gaussians back
                await call("evaluate", f"{ELEMENT}.controlPanel.set({{lossRate: 0.5}})")
                await call("wait_for", f"/^[1-9]/.test({DROPPED})")
                assert await call("evaluate", f"{ELEMENT}.status.failed") is None

    run(work())
