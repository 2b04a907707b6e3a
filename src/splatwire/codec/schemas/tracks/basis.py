"""What a trajectory is a sum of: orthonormal polynomials over the frames of a group."""

import functools

import numpy as np


@functools.cache
def polynomials(frames: int) -> np.ndarray:
    """Discrete Legendre polynomials (Gram, 1883) over equally spaced frames, float64 (frames, frames).

    Column k has degree k; columns are orthonormal. What moves smoothly needs the first few: a constant velocity two,
    where cosines need all odd ones.

    Args:
        frames: Frames of the group, F.
    """
    time = np.linspace(-1.0, 1.0, frames) if frames > 1 else np.zeros(1)
    table = np.zeros((frames, frames))
    for k in range(frames):
        column = time * table[:, k - 1] if k else np.ones(frames)
        for _ in range(2):  # again: once leaves rounding errors in high degrees
            column = column - table[:, :k] @ (table[:, :k].T @ column)
        table[:, k] = column / np.linalg.norm(column)
    table.setflags(write=False)
    return table
