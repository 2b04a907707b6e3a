"""Explicit Gaussians to streams and back by the public functions, without the scene around them."""

from typing import Any

import numpy as np

from splatwire.codec import decode_stream, encode_scene
from splatwire.model import SplatScene
from splatwire.packets import Packetization, SceneStream
from splatwire.scene.background import BLACK, Background
from splatwire.scene.splats import Splats


def encode_splats(
    splats: Splats, packetization: Packetization, *, background: Background = BLACK, tiers: Any = None, **options: Any
) -> SceneStream:
    """The stream of some Gaussians; `tiers` and `options` as of `encode_scene`."""
    tier_of = None if tiers is None else np.asarray(tiers, dtype=np.uint8)
    return encode_scene(SplatScene(splats, background=background), packetization, tiers=tier_of, **options)


def decode_splats(stream: SceneStream, threads: int | None = None) -> tuple[Splats, np.ndarray]:
    """All Gaussians by place, and which of them arrived, bool (N)."""
    partial = decode_stream(stream, threads=threads)
    return partial.scene.splats, partial.known
