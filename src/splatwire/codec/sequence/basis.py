"""Basis functions of trajectories: orthonormal polynomials over the frames of a group."""

import functools

import numpy as np


@functools.cache
def polynomials(num_frames: int) -> np.ndarray:
    """Returns the discrete Legendre polynomials (Gram, 1883) over equally spaced frames, float64 (frames, frames).

    Column k contains the polynomial of degree k; columns are orthonormal.

    Args:
        num_frames: Number of frames in the group.
    """
    time = np.linspace(-1.0, 1.0, num_frames) if num_frames > 1 else np.zeros(1)
    table = np.zeros((num_frames, num_frames))
    for k in range(num_frames):
        column = time * table[:, k - 1] if k else np.ones(num_frames)
        for _ in range(2):  # twice, because one pass leaves rounding errors in high degrees
            column = column - table[:, :k] @ (table[:, :k].T @ column)
        table[:, k] = column / np.linalg.norm(column)
    table.setflags(write=False)
    return table
