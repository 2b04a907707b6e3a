"""Gaussians that move from their bases, in plain numpy with SciPy's rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from splatwire.types.splats import Splats


def moved(splats: Splats, offsets: np.ndarray) -> Splats:
    """Gaussians moved as in `splatwire.types.sequence_scene.GroupMotion.at`, (n, C)."""
    turn, order = offsets[:, 3:6] / 4, np.argsort(-splats.scales, axis=1, kind="stable")
    square = (turn * turn).sum(axis=1, keepdims=True)
    rotation = np.concatenate([1 - square, 2 * turn], axis=1) / (1 + square)
    gains = np.zeros_like(splats.scales)
    np.put_along_axis(gains, order, offsets[:, 6:9], axis=1)
    sh = splats.sh.copy()
    sh[:, 0] += offsets[:, 10:]
    return Splats(
        splats.means + offsets[:, :3],
        turned(rotation, splats.quats),
        splats.scales * np.exp(gains),
        (splats.opacities * np.exp(offsets[:, 9])).clip(None, 1 - 1e-6),
        sh,
    )


def turned(turns: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4), w first: `quats`, then rotated."""
    first, second = (Rotation.from_quat(np.roll(some.astype(np.float64), -1, axis=1)) for some in (turns, quats))
    return np.roll((first * second).as_quat(), 1, axis=1).astype(quats.dtype)
