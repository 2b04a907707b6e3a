"""Numba kernels that code the primary axis of one Gaussian in either direction."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import code_value
from splatwire.codec.schemas.gaussians._gaussian_kernels import follow, octave_of, spread_context
from splatwire.codec.schemas.gaussians.layout import AXIS, DIRECTION_BITS, PRIMARY, R_DIRECTION
from splatwire.ops.compiled import njit

UNIT = 1 << DIRECTION_BITS


@njit(borrows=True, error_model="numpy")
@no_type_check
def predict_axis(rows, primary, near, axis):
    """Weighted sum of the neighbours' axes of the same kind, on the nearest one's side; and their mean deviation."""
    who, weight = near
    total, nearest = np.int64(0), -1
    axis[0] = axis[1] = axis[2] = 0
    for m in range(len(who)):
        j = who[m]
        if rows[j, PRIMARY] == primary:
            nearest = j if nearest < 0 else nearest
            side = np.int64(0)
            for a in range(3):
                side += rows[j, AXIS + a] * rows[nearest, AXIS + a]
            w = weight[m] if side >= 0 else -weight[m]
            for a in range(3):
                axis[a] += w * rows[j, AXIS + a]
            total += weight[m]
    if nearest < 0 or abs(axis[0]) + abs(axis[1]) + abs(axis[2]) == 0:
        axis[2] = UNIT
        return np.int64(0), 0
    deviation, same = np.int64(0), 0
    for m in range(len(who)):
        j = who[m]
        if rows[j, PRIMARY] == primary:
            near, opposite = np.int64(0), np.int64(0)
            for a in range(3):
                mean = axis[a] // total
                near += abs(rows[j, AXIS + a] - mean)
                opposite += abs(rows[j, AXIS + a] + mean)
            deviation += weight[m] * min(near, opposite)
            same += 1
    return deviation // total, same


@njit(borrows=True, error_model="numpy")
@no_type_check
def _largest(axis):
    """The coordinate of the largest magnitude, the first of them."""
    pole = 0
    for a in range(1, 3):
        if abs(axis[a]) > abs(axis[pole]):
            pole = a
    return pole


@njit(borrows=True, error_model="numpy")
@no_type_check
def round_axis(source, shift, axis):
    """Rounds an axis to multiples of `1 << shift` whose magnitudes add up to `UNIT`."""
    pole = _largest(source)
    first, second = (pole + 1) % 3, (pole + 2) % 3
    length = abs(source[0]) + abs(source[1]) + abs(source[2])
    sign = 2.0**-shift * UNIT / length if source[pole] >= 0 else -(2.0**-shift) * UNIT / length
    axis[first] = np.int64(np.rint(source[first] * sign)) << shift
    axis[second] = np.int64(np.rint(source[second] * sign)) << shift
    axis[pole] = UNIT - abs(axis[first]) - abs(axis[second])


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_side(coder, spread, running, axis, pole, other, shift):
    """Codes two coordinates of an axis, from `axis`, which is the neighbours' mean; `other` is the axis, rounded."""
    first, second = (pole + 1) % 3, (pole + 2) % 3
    norm = abs(axis[0]) + abs(axis[1]) + abs(axis[2])
    side = -1 if other[pole] < 0 else 1
    mean = (axis[first] << DIRECTION_BITS) // norm
    x, steps = code_value(coder, R_DIRECTION, spread, octave_of(running), mean, side * other[first], shift, True)
    running, x = follow(running, steps), min(max(x, -UNIT), UNIT)
    mean = (axis[second] << DIRECTION_BITS) // norm
    y, steps = code_value(coder, R_DIRECTION, spread, octave_of(running), mean, side * other[second], shift, True)
    running, y = follow(running, steps), min(max(y, abs(x) - UNIT), UNIT - abs(x))
    axis[first], axis[second], axis[pole] = x, y, UNIT - abs(x) - abs(y)
    if axis[_largest(axis)] < 0:
        for a in range(3):
            axis[a] = -axis[a]
    return running


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_axis(coder, rows, i, primary, source, shift, near, running, axis, other, absolute):
    """Codes an axis as seen from the coordinate axis nearest to the neighbours' mean axis.

    On an octahedral square; where places on it depend on no neighbour, by its coordinates.
    """
    deviation, same = predict_axis(rows, primary, near, axis)
    spread, pole = spread_context(same, deviation, shift), _largest(axis)
    if axis[pole] < 0:
        for a in range(3):
            axis[a] = -axis[a]
    if absolute:
        if not coder.decoding:
            round_axis(source, shift, other)
        running = _code_side(coder, spread, running, axis, pole, other, shift)
        for a in range(3):
            rows[i, AXIS + a] = axis[a]
        return running
    first, second = (pole + 1) % 3, (pole + 2) % 3
    norm = abs(axis[0]) + abs(axis[1]) + abs(axis[2])
    e0, e1 = np.int64(0), np.int64(0)
    if not coder.decoding:
        length = abs(source[0]) + abs(source[1]) + abs(source[2])
        sign = UNIT / length if source[pole] >= 0 else -UNIT / length
        e0 = np.int64(np.rint((source[first] + source[second]) * sign))
        e1 = np.int64(np.rint((source[first] - source[second]) * sign))
    mean = ((axis[first] + axis[second]) << DIRECTION_BITS) // norm
    e0, steps = code_value(coder, R_DIRECTION, spread, octave_of(running), mean, e0, shift, False)
    running, e0 = follow(running, steps), min(max(e0, -UNIT), UNIT)
    mean = ((axis[first] - axis[second]) << DIRECTION_BITS) // norm
    e1, steps = code_value(coder, R_DIRECTION, spread, octave_of(running), mean, e1, shift, False)
    running, e1 = follow(running, steps), min(max(e1, -UNIT), UNIT)
    x, y = (e0 + e1) >> 1, (e0 - e1) >> 1
    rows[i, AXIS + first], rows[i, AXIS + second] = x, y
    rows[i, AXIS + pole] = max(UNIT - abs(x) - abs(y), 0)
    return running
