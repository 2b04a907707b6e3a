"""What the page draws, beside what the renderer draws."""

import base64
import io
import json

import numpy as np
from PIL import Image

from scenes import tiny_cameras
from splatwire.codec import decode_stream
from splatwire.packets import SceneStream
from splatwire.render import render_scene
from transport.chromium import Browser

ELEMENT = "document.querySelector('splat-wire')"


def check_pictures(page: Browser, stream: SceneStream, least: float) -> None:
    """What the page draws is what the renderer draws, from the same cameras, to `least` decibels."""
    cameras = tiny_cameras(2, 240, 180)
    page.evaluate(
        f"{ELEMENT}.style.cssText = 'position: fixed; inset: auto; left: 0; top: 0; width: 240px; height: 180px'"
    )
    for view, expected in enumerate(render_scene(decode_stream(stream).scene, cameras)):
        camera = {"viewmat": cameras.viewmats[view].tolist(), "focal": float(cameras.Ks[view, 1, 1]), "height": 180}
        picture = page.resolve(f"{ELEMENT}.picture({json.dumps(camera)})").split(",")[1]
        found = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")) / 255.0
        error = ((found - expected.numpy()) ** 2).mean()
        assert -10 * np.log10(error) > least, f"view {view}: {-10 * np.log10(error):.1f} dB"
    page.evaluate(f"{ELEMENT}.view.fix(null); {ELEMENT}.removeAttribute('style')")
