"""Numba kernel that moves Gaussians from their bases; `tests/reference/moved.py` says it plainly."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

_LEAST, _MOST = 1e-12, 1.0 - 1e-6


@njit(borrows=True, error_model="numpy")
@no_type_check
def _turn(quat, offset, found):
    """A unit quaternion, turned further by a vector of four times the tangent of a quarter of the angle."""
    x, y, z = offset[3] / np.float64(4.0), offset[4] / np.float64(4.0), offset[5] / np.float64(4.0)
    square = x * x + y * y + z * z
    below = np.float64(1.0) + square
    w, x, y, z = (np.float64(1.0) - square) / below, 2.0 * x / below, 2.0 * y / below, 2.0 * z / below
    e, f, g, h = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    a = w * e - x * f - y * g - z * h
    b = w * f + x * e + y * h - z * g
    c = w * g - x * h + y * e + z * f
    d = w * h + x * g - y * f + z * e
    length = max(np.sqrt(a * a + b * b + c * c + d * d), _LEAST)
    found[0], found[1], found[2], found[3] = a / length, b / length, c / length, d / length


@njit(borrows=True, error_model="numpy")
@no_type_check
def _grow(scales, offset, found):
    """Scales times what falls to them by their size, the largest first, of equal ones the earlier."""
    if offset[6] == 0.0 and offset[7] == 0.0 and offset[8] == 0.0:
        for a in range(3):
            found[a] = scales[a]
        return
    for a in range(3):
        rank = 0
        for b in range(3):
            rank += scales[b] > scales[a] or (scales[b] == scales[a] and b < a)
        found[a] = scales[a] * np.exp(np.float64(offset[6 + rank]))


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def move(bases, tracks, offsets, found):
    """Moves Gaussians.

    Args:
        bases: Means (T, 3), quaternions (T, 4), scales (T, 3), opacities (T), harmonics (T, 3 B); float32.
        tracks: Which of them, int64 (n).
        offsets: As `splatwire.model.clip.GroupMotion.at` says, float32 (n, C).
        found: The same of those that moved.
    """
    means, quats, scales, opacities, harmonics = bases
    for n in range(len(tracks)):
        t, offset = tracks[n], offsets[n]
        for a in range(3):
            found[0][n, a] = means[t, a] + offset[a]
        _turn(quats[t], offset, found[1][n])
        _grow(scales[t], offset, found[2][n])
        opacity = np.float64(opacities[t])
        if offset[9] != 0.0:
            opacity *= np.exp(np.float64(offset[9]))
        found[3][n] = min(opacity, _MOST)
        for c in range(harmonics.shape[1]):
            found[4][n, c] = harmonics[t, c]
        for a in range(3):
            found[4][n, a] += offset[10 + a]
