"""Shells of explicit Gaussians with smooth colours, for tests of pictures."""

import numpy as np

from splatwire.types import SplatScene
from splatwire.types.splats import Splats


def shell(count: int, degree: int = 0, *, seed: int = 0) -> SplatScene:
    """Overlapping Gaussians of many shapes on a sphere of radius 1, with smooth colours."""
    rng = np.random.Generator(np.random.PCG64(seed))
    places = rng.normal(size=(count, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = 1.2 / np.sqrt(count) * rng.uniform(0.3, 1.5, (count, 3))
    sh = 0.1 * rng.normal(size=(count, (degree + 1) ** 2, 3))
    sh[:, 0] = np.sin(3 * places)
    columns = places, quats, scales, rng.uniform(0.2, 0.95, count), sh
    return SplatScene(Splats(*(np.ascontiguousarray(c, np.float32) for c in columns)), background=(0.2, 0.1, 0.3))
