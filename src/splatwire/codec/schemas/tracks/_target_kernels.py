"""Numba kernel that turns what tracks do into coefficients; `tests/reference/trajectories.py` says the same plainly."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.ops.compiled import njit

_TURN, _FIXED = 4.0 * (1 << DIRECTION_BITS), 1.0 * (1 << BITS)
_ZERO, _ONE = np.float64(0.0), np.float64(1.0)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _turns(quats, base, begin, end, last, far, values):
    """Rotations of a track from its base in some frames, see `trajectories.rotation_vectors`.

    `last`, the rotation in the frame before, becomes that in the last frame. Returns the largest one's length, or
    `far`, that of frames before.
    """
    length, b0, b1, b2, b3 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for f in range(begin, end):
        same = last[0] == _ONE and last[1] == 0 and last[2] == 0 and last[3] == 0
        for a in range(4):
            same &= quats[f, a] == base[a]
        if same:
            values[3, f], values[4, f], values[5, f] = _ZERO, _ZERO, _ZERO
            continue
        if length == 0:
            for a in range(4):
                length += np.float64(base[a]) * np.float64(base[a])
            length = np.sqrt(length)
            b0, b1, b2, b3 = base[0] / length, base[1] / length, base[2] / length, base[3] / length
        q0, q1, q2, q3 = (
            np.float64(quats[f, 0]),
            np.float64(quats[f, 1]),
            np.float64(quats[f, 2]),
            np.float64(quats[f, 3]),
        )
        size = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        q0, q1, q2, q3 = q0 / size, q1 / size, q2 / size, q3 / size
        w = q0 * b0 + q1 * b1 + q2 * b2 + q3 * b3
        x = b0 * q1 - q0 * b1 - (q2 * b3 - q3 * b2)
        y = b0 * q2 - q0 * b2 - (q3 * b1 - q1 * b3)
        z = b0 * q3 - q0 * b3 - (q1 * b2 - q2 * b1)
        if w * last[0] + x * last[1] + y * last[2] + z * last[3] < 0:
            w, x, y, z = -w, -x, -y, -z
        last[0], last[1], last[2], last[3] = w, x, y, z
        below = max(_ONE + w, 1e-3)
        x, y, z = x / below, y / below, z / below
        far = max(far, np.sqrt(x * x + y * y + z * z))
        values[3, f], values[4, f], values[5, f] = x * _TURN, y * _TURN, z * _TURN
    return far


@njit(borrows=True, error_model="numpy")
@no_type_check
def _sizes(scales, opacities, base, opacity, begin, end, values):
    """Logarithms of scales, by falling size of the base's, and of opacity; what is as in the base takes none."""
    for rank in range(3):
        here = 0
        for axis in range(3):  # as many are before it as are larger, or as large and before it
            before = 0
            for other in range(3):
                before += base[other] > base[axis] or (base[other] == base[axis] and other < axis)
            if before == rank:
                here = axis
        for f in range(begin, end):
            same = scales[f, here] == base[here]
            values[6 + rank, f] = (
                _ZERO if same else (np.log2(np.float64(scales[f, here])) - np.log2(np.float64(base[here]))) * _FIXED
            )
    for f in range(begin, end):
        same = opacities[f] == opacity
        values[9, f] = _ZERO if same else (np.log2(np.float64(opacities[f])) - np.log2(np.float64(opacity))) * _FIXED


@njit(borrows=True, error_model="numpy")
@no_type_check
def _project(values, table, begin, end, own):
    """Adds some frames to the coefficients of each channel; what is zero adds nothing."""
    for c in range(NUM_CHANNELS):
        for f in range(begin, end):
            value = values[c, f]
            if value != 0:
                for k in range(len(table)):
                    own[c, k] += value * table[f, k]


@njit(nogil=True, error_model="numpy")
@no_type_check
def fit_targets(moves, bases, numbers, unit, luma, table, begin, end, targets, largest, turns, last):
    """Coefficients of what tracks do, see `trajectories.targets_of`; frame by frame, so that the first need not wait.

    Args:
        moves: Means, quaternions, scales, opacities, colours of n tracks, float32 (n, F, ...).
        bases: The same of bases, float32 (T, 1, ...).
        numbers: Base of each track, int64 (n); nothing is said of one below 0.
        unit: Units of place in one of the scene.
        luma: Colours to luma and chroma, float64 (3, 3).
        table: Polynomials, float64 (F, F).
        begin: First frame that was not looked at.
        end: First frame after those that are looked at.
        targets: float64 (n, C, F), of the frames before, zero before all; added to.
        largest: Largest magnitude of each channel's coefficients, float64 (n, C), filled with the last frame.
        turns: Tangent of a quarter of the largest rotation, float64 (n), zero before all.
        last: Rotation in the last frame that was looked at, float64 (n, 4), none before all.
    """
    means, quats, scales, opacities, colours = moves
    m, q, s, o, c = bases
    values = np.empty((NUM_CHANNELS, len(table)))
    for i in range(len(numbers)):
        j = numbers[i]
        if j < 0:
            continue
        for f in range(begin, end):
            for a in range(3):
                values[a, f] = (np.float64(means[i, f, a]) - np.float64(m[j, 0, a])) * unit
                total = _ZERO
                for b in range(3):
                    total += (np.float64(colours[i, f, b]) - np.float64(c[j, 0, b])) * luma[a, b]
                values[10 + a, f] = total
        turns[i] = _turns(quats[i], q[j, 0], begin, end, last[i], turns[i], values)
        _sizes(scales[i], opacities[i], s[j, 0], o[j, 0], begin, end, values)
        _project(values, table, begin, end, targets[i])
        if end < len(table):
            continue
        for channel in range(NUM_CHANNELS):
            most = _ZERO
            for k in range(len(table)):
                most = max(most, abs(targets[i, channel, k]))
            largest[i, channel] = most


@njit(nogil=True, error_model="numpy")
@no_type_check
def judge(largest, turns, shifts, numbers, limits, far, moving):
    """Finds tracks that went further than their bases allow, and those that move by more than nothing.

    Args:
        largest: Largest magnitude of each channel's coefficients, float64 (n, C).
        turns: See `fit_targets`, float64 (n).
        shifts: log2 of the steps of all tracks, int64 (T, C).
        numbers: Which of these each of the n is, int64 (n).
        limits: Most steps, largest coefficient and turn; least part of a step that is told, float64 (4).
        far: bool (n), filled.
        moving: bool (n), filled.
    """
    for i in range(len(numbers)):
        own, gone, moves = shifts[numbers[i]], turns[i] > limits[2], False
        for c in range(NUM_CHANNELS):
            step, most = np.float64(np.int64(1) << own[c]), largest[i, c]
            gone = gone or most > limits[0] * step or most > limits[1]
            moves = moves or most >= limits[3] * step
        far[i], moving[i] = gone, moves
