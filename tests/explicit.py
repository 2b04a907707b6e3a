"""Encoding and decoding of explicit Gaussians by the public functions."""

from typing import Any

import numpy as np

from random_numbers import Numbers
from splatwire.bitstream import Packetization, SceneStream
from splatwire.codec import decode_stream, encode_scene
from splatwire.types import SplatScene
from splatwire.types.background import BLACK, Background
from splatwire.types.splats import Splats


def encode_splats(
    splats: Splats, packetization: Packetization, *, background: Background = BLACK, tiers: Any = None, **options: Any
) -> SceneStream:
    """Stream of Gaussians; `tiers` and `options` as in `encode_scene`."""
    tier_of = None if tiers is None else np.asarray(tiers, dtype=np.uint8)
    return encode_scene(SplatScene(splats, background=background), packetization, tiers=tier_of, **options)


def decode_splats(stream: SceneStream, threads: int | None = None) -> tuple[Splats, np.ndarray]:
    """All Gaussians by rank, and the mask of received ones, bool (N)."""
    received = decode_stream(stream, threads=threads)
    return received.scene.splats, received.fully_received


def ball_of_gaussians() -> Splats:
    """A ball of Gaussians."""
    rng = Numbers(4)
    quats = rng.randn(200, 4)
    return Splats(
        0.4 * rng.randn(200, 3),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        0.05 + 0.1 * rng.rand(200, 3),
        0.2 + 0.6 * rng.rand(200),
        0.5 * rng.randn(200, 1, 3),
    )
