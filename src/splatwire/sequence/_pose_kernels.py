"""Numba kernel that applies motion to keyframe Gaussians."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

_MIN_LENGTH, _MAX_OPACITY = 1e-12, 1.0 - 1e-6
_MAX_SCALE = float(np.finfo(np.float32).max)
"""Limit of moved scales: packets with arbitrary bytes can contain any change, and results must be finite."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def _rotate(quat, offset, out):
    """Rotates a keyframe Gaussian to its orientation in one frame of its track (one Gaussian over time).

    Args:
        quat: Unit quaternion of the keyframe Gaussian, (w, x, y, z).
        offset: Changes of the track, see `GroupMotion.at`; entries 3 to 5 are the rotation.
        out: Output: the rotated unit quaternion.
    """
    # A rotation vector: its direction is the axis, and its length is 4 tan(angle / 4).
    x, y, z = offset[3] / np.float64(4.0), offset[4] / np.float64(4.0), offset[5] / np.float64(4.0)
    square = x * x + y * y + z * z
    below = np.float64(1.0) + square
    w, x, y, z = (np.float64(1.0) - square) / below, 2.0 * x / below, 2.0 * y / below, 2.0 * z / below
    e, f, g, h = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    a = w * e - x * f - y * g - z * h
    b = w * f + x * e + y * h - z * g
    c = w * g - x * h + y * e + z * f
    d = w * h + x * g - y * f + z * e
    length = max(np.sqrt(a * a + b * b + c * c + d * d), _MIN_LENGTH)
    out[0], out[1], out[2], out[3] = a / length, b / length, c / length, d / length


@njit(borrows=True, error_model="numpy")
@no_type_check
def _scale(scales, offset, out):
    """Scales a keyframe Gaussian to its size in one frame of its track (one Gaussian over time).

    Args:
        scales: Standard deviations of the keyframe Gaussian along its axes.
        offset: Changes of the track, see `GroupMotion.at`. Entries 6, 7 and 8 are added to the natural logarithms of
            the largest, the middle and the smallest standard deviation.
        out: Output: the changed standard deviations.
    """
    if offset[6] == 0.0 and offset[7] == 0.0 and offset[8] == 0.0:
        for a in range(3):
            out[a] = scales[a]
        return
    for a in range(3):
        rank = 0
        for b in range(3):
            # of equal scales, the one with the lower index counts as larger
            rank += scales[b] > scales[a] or (scales[b] == scales[a] and b < a)
        out[a] = min(scales[a] * np.exp(np.float64(offset[6 + rank])), _MAX_SCALE)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def move(keyframes, tracks, offsets, out):
    """Computes the Gaussians of tracks in one frame: keyframe Gaussians, changed by decoded motion.

    A track is one Gaussian over time. Its motion is coded relative to its keyframe Gaussian.

    Args:
        keyframes: Keyframe means (T, 3), quaternions (T, 4), scales (T, 3), opacities (T) and spherical harmonics,
            flattened from (T, B, 3) to (T, 3 B); float32.
        tracks: Indices of the n tracks in `keyframes`, int64 (n).
        offsets: Changes of the n tracks relative to their keyframe Gaussians, float32 (n, C); see `GroupMotion.at`.
        out: Output: arrays of the same attributes for the n tracks.
    """
    means, quats, scales, opacities, harmonics = keyframes
    for n in range(len(tracks)):
        t, offset = tracks[n], offsets[n]
        for a in range(3):
            out[0][n, a] = means[t, a] + offset[a]
        _rotate(quats[t], offset, out[1][n])
        _scale(scales[t], offset, out[2][n])
        opacity = np.float64(opacities[t])
        if offset[9] != 0.0:
            opacity *= np.exp(np.float64(offset[9]))
        out[3][n] = min(opacity, _MAX_OPACITY)
        for c in range(harmonics.shape[1]):
            out[4][n, c] = harmonics[t, c]
        for a in range(3):
            out[4][n, a] += offset[10 + a]
