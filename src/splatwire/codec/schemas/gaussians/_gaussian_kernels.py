"""Numba kernels that code one Gaussian in either direction, from its nearest neighbours among those before it."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.gaussians._coder_kernels import code_bit, code_residual
from splatwire.codec.schemas.gaussians.layout import (
    AXIS,
    BITS,
    CLASS,
    COEFFICIENTS,
    DIRECTION_BITS,
    FAR,
    FIRST_CLASS,
    LUMA,
    MAX_CLASSES,
    MAX_COLOUR,
    MAX_LOG,
    MAX_OPACITY,
    MAX_THIN,
    MIN_OPACITY,
    NUM_NEIGHBOURS,
    OPACITY,
    PRIMARY,
    R_DIRECTION,
    R_LUMA,
    R_OPACITY,
    R_SCALE0,
    R_SCALE1,
    R_SCALE2,
    S_COLOUR,
    S_OPACITY,
    S_SCALE0,
    S_SCALE1,
    S_SCALE2,
    SCALE0,
    SCALE1,
    SCALE2,
    SECONDS,
    SPREADS,
    STEP_BITS,
    WINDOW,
)
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit

UNIT = 1 << DIRECTION_BITS


@njit(borrows=True, error_model="numpy")
@no_type_check
def find_neighbours(cells, i, who, far):
    """The nearest of the Gaussians just before i, nearest first; `far` ends as their weights. Returns how many."""
    count = 0
    for j in range(i - 1, max(i - WINDOW, 0) - 1, -1):
        x, y, z = cells[i, 0] - cells[j, 0], cells[i, 1] - cells[j, 1], cells[i, 2] - cells[j, 2]
        d = min(x * x + y * y + z * z, FAR)
        if count == NUM_NEIGHBOURS and d >= far[count - 1]:
            continue
        at = count if count < NUM_NEIGHBOURS else count - 1
        while at > 0 and far[at - 1] > d:
            far[at], who[at] = far[at - 1], who[at - 1]
            at -= 1
        far[at], who[at] = d, j
        count = min(count + 1, NUM_NEIGHBOURS)
    nearest = (far[0] + 1) << 12
    for m in range(count):
        far[m] = nearest // (far[m] + 1)
    return count


@njit(borrows=True, error_model="numpy")
@no_type_check
def predict(rows, column, default, near):
    """Weighted mean of a column of the neighbours `near` (which, weight), and their weighted mean deviation from it."""
    who, weight = near
    if len(who) == 0:
        return default, np.int64(0)
    total, sums = np.int64(0), np.int64(0)
    for m in range(len(who)):
        total += weight[m]
        sums += weight[m] * rows[who[m], column]
    mean = sums // total
    deviation = np.int64(0)
    for m in range(len(who)):
        deviation += weight[m] * abs(rows[who[m], column] - mean)
    return mean, deviation // total


@njit(borrows=True, error_model="numpy")
@no_type_check
def spread_context(count, deviation, shift):
    """Context of a residual: no neighbour, too few, or how much they differ in steps, in octaves."""
    if count < 3:
        return 0 if count == 0 else 1
    ratio = (deviation << 3) >> shift
    octave = 0
    while ratio >> octave and octave < SPREADS - 3:
        octave += 1
    return 2 + octave


@njit(borrows=True, error_model="numpy")
@no_type_check
def follow(running, residual, shift):
    """Running magnitude of a Gaussian's residuals in sixteenths of a step, after one more."""
    return (running + (min(abs(residual) >> shift, 1 << 14) << 4)) >> 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def octave_of(running):
    """Context of a residual: how large those before it in the same Gaussian were, in octaves."""
    octave = 0
    while running >> octave and octave < SECONDS - 1:
        octave += 1
    return octave


@njit(borrows=True, error_model="numpy")
@no_type_check
def exponent(bases, which, level, area, long, thin, opacity):
    """`-log2` of a step, rounded: finer with the class, and as `COEFFICIENTS` says."""
    c = COEFFICIENTS[which]
    sums = c[0] * area + c[1] * long + c[2] * thin + c[3] * opacity
    sums += (bases[which] + (level << STEP_BITS)) << BITS
    return (sums + (1 << (BITS + STEP_BITS - 1))) >> (BITS + STEP_BITS)


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_class(coder, rows, value, near):
    """Codes the class as three bits, in the context of the mean class of the neighbours in half classes."""
    who, weight = near
    total, sums = np.int64(0), np.int64(0)
    for m in range(len(who)):
        total += weight[m]
        sums += weight[m] * rows[who[m], CLASS]
    context = 0 if len(who) == 0 else 1 + (4 * sums + total) // (2 * total)
    base, node = FIRST_CLASS + context * MAX_CLASSES, 1
    for shift in range(2, -1, -1):
        node = 2 * node + code_bit(coder, base + node, (value >> shift) & 1)
    return node - MAX_CLASSES


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_logs(coder, rows, i, source, bases, defaults, level, near, thinness):
    """Codes opacity and scales, each from the neighbours' and with a step from what is known already."""
    mean, deviation = predict(rows, OPACITY, defaults[0], near)
    shift = min(max(BITS - exponent(bases, S_OPACITY, level, ZERO, ZERO, ZERO, ZERO), 0), BITS)
    spread = spread_context(len(near[0]), deviation, shift)
    residual = code_residual(coder, R_OPACITY, spread, shift, source[0] - mean, shift)
    running, opacity = follow(np.int64(16), residual, shift), mean + residual
    opacity = min(max(opacity, MIN_OPACITY), MAX_OPACITY)
    mean, deviation = predict(rows, SCALE0, defaults[1], near)
    area = 2 * mean - (2 << BITS)
    shift = min(max(BITS - exponent(bases, S_SCALE0, level, area, ZERO, ZERO, opacity), 0), BITS - 1)
    spread = spread_context(len(near[0]), deviation, shift)
    residual = code_residual(coder, R_SCALE0, spread, shift, source[1] - mean, shift)
    running, s0 = follow(running, residual, shift), mean + residual
    s0 = min(max(s0, -MAX_LOG), MAX_LOG)
    mean, deviation = predict(rows, SCALE1, defaults[2], near)
    area = 2 * s0 - (2 << BITS)
    shift = min(max(BITS - exponent(bases, S_SCALE1, level, area, ZERO, ZERO, opacity), 0), BITS - 1)
    spread = spread_context(len(near[0]), deviation, shift)
    residual = code_residual(coder, R_SCALE1, spread, octave_of(running), s0 - source[2] - mean, shift)
    running, long = follow(running, residual, shift), mean + residual
    long = min(max(long, 0), MAX_LOG)
    mean, deviation = predict(rows, SCALE2, defaults[3], near)
    shift = min(max(BITS - exponent(bases, S_SCALE2, level, 2 * s0 - long, long, ZERO, opacity), 0), BITS - 1)
    spread = spread_context(len(near[0]), deviation, shift)
    target = np.int64(0)
    if not coder.decoding:
        ratio = max(s0 - long - source[3], 0) / (1 << BITS)
        target = np.int64(np.rint((1 - 2.0**-ratio) / np.log(2.0) * (1 << BITS)))
    residual = code_residual(coder, R_SCALE2, spread, octave_of(running), target - mean, shift)
    running, thin = follow(running, residual, shift), mean + residual
    thin = min(max(thin, 0), MAX_THIN)
    rows[i, OPACITY], rows[i, SCALE0], rows[i, SCALE1], rows[i, SCALE2] = opacity, s0, long, thin
    return s0, long, thinness[thin], opacity, running


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
def code_axis(coder, rows, i, primary, source, shift, near, running, axis):
    """Codes an axis on an octahedral square whose pole is the coordinate axis nearest to the neighbours' mean axis."""
    deviation, same = predict_axis(rows, primary, near, axis)
    pole = 0
    for a in range(1, 3):
        if abs(axis[a]) > abs(axis[pole]):
            pole = a
    if axis[pole] < 0:
        for a in range(3):
            axis[a] = -axis[a]
    first, second = (pole + 1) % 3, (pole + 2) % 3
    norm = abs(axis[0]) + abs(axis[1]) + abs(axis[2])
    mean0 = ((axis[first] + axis[second]) << DIRECTION_BITS) // norm
    mean1 = ((axis[first] - axis[second]) << DIRECTION_BITS) // norm
    target0, target1 = np.int64(0), np.int64(0)
    if not coder.decoding:
        length = abs(source[0]) + abs(source[1]) + abs(source[2])
        sign = UNIT / length if source[pole] >= 0 else -UNIT / length
        target0 = np.int64(np.rint((source[first] + source[second]) * sign))
        target1 = np.int64(np.rint((source[first] - source[second]) * sign))
    spread = spread_context(same, deviation, shift)
    residual = code_residual(coder, R_DIRECTION, spread, octave_of(running), target0 - mean0, shift)
    running, e0 = follow(running, residual, shift), min(max(mean0 + residual, -UNIT), UNIT)
    residual = code_residual(coder, R_DIRECTION, spread, octave_of(running), target1 - mean1, shift)
    running, e1 = follow(running, residual, shift), min(max(mean1 + residual, -UNIT), UNIT)
    x, y = (e0 + e1) >> 1, (e0 - e1) >> 1
    rows[i, AXIS + first], rows[i, AXIS + second] = x, y
    rows[i, AXIS + pole] = max(UNIT - abs(x) - abs(y), 0)
    return running


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_colour(coder, rows, i, source, bases, defaults, level, near, running):
    """Codes luma and chroma; the magnitude of the component before is a context."""
    shift = min(max(BITS - exponent(bases, S_COLOUR, level, ZERO, ZERO, ZERO, ZERO), 0), BITS - 2)
    for c in range(3):
        mean, deviation = predict(rows, LUMA + c, defaults[4 + c], near)
        spread = spread_context(len(near[0]), deviation, shift)
        residual = code_residual(coder, R_LUMA + c, spread, octave_of(running), source[c] - mean, shift)
        rows[i, LUMA + c] = min(max(mean + residual, -MAX_COLOUR), MAX_COLOUR)
        running = follow(running, residual, shift)
