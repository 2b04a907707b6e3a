"""Pictures of the page against pictures of the renderer."""

import base64
import io
import json

import numpy as np
from PIL import Image

from scenes import tiny_cameras
from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import sections_of
from splatwire.codec import decode_stream
from splatwire.concealment import conceal
from splatwire.render import render_scene
from transport.chromium import Browser

ELEMENT = "document.querySelector('splat-wire')"


def check_concealed(page: Browser, url: str, stream: SceneStream, least: float) -> None:
    """Half of a stream's packets; the page at that address conceals losses like Python."""
    page.open(url)
    page.wait_for(f"{ELEMENT}?.status && {ELEMENT}.status.finished && {ELEMENT}.status.gaussians > 0")
    best = "sketch" if "sketch" in concealers_of(stream) else "grow"
    assert page.evaluate(f"{ELEMENT}.controlPanel.settings.concealer") == best
    pictures = [check_pictures(page, stream, least, name) for name in ("drop", *concealers_of(stream))]
    assert len(set(pictures)) == len(pictures), "two concealers draw the same"


def concealers_of(stream: SceneStream) -> tuple[str, ...]:
    """Concealers that the page offers in addition to `drop`."""
    return ("grow", "scene_free", *(("sketch",) if "sketch" in sections_of(stream) else ()))


def half_of(stream: SceneStream) -> SceneStream:
    """Every second packet of a stream."""
    return stream.with_packets(stream.packets[::2])


def check_pictures(page: Browser, stream: SceneStream, least: float, concealer: str = "drop") -> str:
    """Compares the page with the renderer for the same cameras to `least` decibels; returns the last picture."""
    cameras, picture = tiny_cameras(2, 240, 180), ""
    page.evaluate(f"{ELEMENT}.controlPanel.set({{concealer: '{concealer}'}})")
    page.evaluate(
        f"{ELEMENT}.style.cssText = 'position: fixed; inset: auto; left: 0; top: 0; width: 240px; height: 180px'"
    )
    for view, expected in enumerate(render_scene(conceal(decode_stream(stream), concealer), cameras)):
        camera = {"viewmat": cameras.viewmats[view].tolist(), "focal": float(cameras.Ks[view, 1, 1]), "height": 180}
        picture = page.resolve(f"{ELEMENT}.picture({json.dumps(camera)})").split(",")[1]
        found = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")) / 255.0
        error = ((found - expected) ** 2).mean()
        assert -10 * np.log10(error) > least, f"view {view}, {concealer}: {-10 * np.log10(error):.1f} dB"
    page.evaluate(f"{ELEMENT}.removeAttribute('style')")
    return picture
