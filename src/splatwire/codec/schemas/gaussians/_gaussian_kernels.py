"""Numba kernels that code one Gaussian in either direction, from its nearest neighbours among those before it."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import code_bit, code_value
from splatwire.codec.schemas._step_kernels import place_shift, shift_of
from splatwire.codec.schemas.gaussians.layout import (
    BITS,
    CLASS,
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
    WINDOW,
)
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit


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
def follow(running, steps):
    """Running magnitude of a Gaussian's residuals in sixteenths of a step, after one more."""
    return (running + (min(abs(steps), 1 << 14) << 4)) >> 1


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
def thinness_of(ratio, thinness):
    """The companded value whose logarithm is nearest to this one: exactly the inverse of the table."""
    low, high = 0, len(thinness) - 1
    while low < high:
        middle = (low + high) >> 1
        if thinness[middle] < ratio:
            low = middle + 1
        else:
            high = middle
    return low - 1 if low and ratio - thinness[low - 1] < thinness[low] - ratio else low


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_logs(coder, rows, i, source, bases, defaults, level, near, thinness, absolute):
    """Codes opacity and scales, each from the neighbours' and with a step from what is known already."""
    count = len(near[0])
    mean, deviation = predict(rows, OPACITY, defaults[0], near)
    shift = shift_of(bases, S_OPACITY, level, ZERO, ZERO, ZERO, ZERO, BITS)
    spread = spread_context(count, deviation, shift)
    opacity = source[0] + 1 if source[0] == MAX_OPACITY else source[0]
    opacity, steps = code_value(coder, R_OPACITY, spread, shift, mean, opacity, shift, absolute)
    running, opacity = follow(np.int64(16), steps), min(max(opacity, MIN_OPACITY), MAX_OPACITY)
    mean, deviation = predict(rows, SCALE0, defaults[1], near)
    area = ZERO if absolute else 2 * mean - (2 << BITS)
    shift = shift_of(bases, S_SCALE0, level, area, ZERO, ZERO, opacity, BITS - 1)
    spread = spread_context(count, deviation, shift)
    s0, steps = code_value(coder, R_SCALE0, spread, shift, mean, source[1], shift, absolute)
    running, s0 = follow(running, steps), min(max(s0, -MAX_LOG), MAX_LOG)
    mean, deviation = predict(rows, SCALE1, defaults[2], near)
    shift = shift_of(bases, S_SCALE1, level, 2 * s0 - (2 << BITS), ZERO, ZERO, opacity, BITS - 1)
    spread = spread_context(count, deviation, shift)
    long, steps = code_value(coder, R_SCALE1, spread, octave_of(running), mean, s0 - source[2], shift, absolute)
    running, long = follow(running, steps), min(max(long, 0), MAX_LOG)
    mean, deviation = predict(rows, SCALE2, defaults[3], near)
    shift = shift_of(bases, S_SCALE2, level, 2 * s0 - long, long, ZERO, opacity, BITS - 1)
    spread = spread_context(count, deviation, shift)
    target = np.int64(0)
    if not coder.decoding:
        target = thinness_of(max(s0 - long - source[3], 0), thinness)
    thin, steps = code_value(coder, R_SCALE2, spread, octave_of(running), mean, target, shift, absolute)
    most = (MAX_THIN >> shift) << shift if absolute else MAX_THIN
    running, thin = follow(running, steps), min(max(thin, 0), most)
    rows[i, OPACITY], rows[i, SCALE0], rows[i, SCALE1], rows[i, SCALE2] = opacity, s0, long, thin
    return s0, long, thinness[thin], opacity, running


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_colour(coder, rows, i, source, bases, defaults, level, near, running, absolute):
    """Codes luma and chroma; the magnitude of the component before is a context."""
    shift = shift_of(bases, S_COLOUR, level, ZERO, ZERO, ZERO, ZERO, BITS - 2)
    for c in range(3):
        mean, deviation = predict(rows, LUMA + c, defaults[4 + c], near)
        spread = spread_context(len(near[0]), deviation, shift)
        value, steps = code_value(coder, R_LUMA + c, spread, octave_of(running), mean, source[c], shift, absolute)
        rows[i, LUMA + c] = min(max(value, -MAX_COLOUR), MAX_COLOUR)
        running = follow(running, steps)


@njit(nogil=True, error_model="numpy")
@no_type_check
def place_shifts(logs, levels, bases, unit, coarsest, thinness, shifts):
    """log2 of the cell of each Gaussian's place, in lattice units: from its own logarithms, rounded as they are coded.

    `logs`, int64 (n, 4), are as in `Sources`, `levels`, int64 (n), classes; the result goes to `shifts`, int64 (n).
    """
    for i in range(len(logs)):
        level, source = levels[i], logs[i]
        shift = shift_of(bases, S_OPACITY, level, ZERO, ZERO, ZERO, ZERO, BITS)
        opacity = source[0] + 1 if source[0] == MAX_OPACITY else source[0]
        opacity = min(max(_rounded(opacity, shift), MIN_OPACITY), MAX_OPACITY)
        shift = shift_of(bases, S_SCALE0, level, ZERO, ZERO, ZERO, opacity, BITS - 1)
        s0 = min(max(_rounded(source[1], shift), -MAX_LOG), MAX_LOG)
        shift = shift_of(bases, S_SCALE1, level, 2 * s0 - (2 << BITS), ZERO, ZERO, opacity, BITS - 1)
        long = min(max(_rounded(s0 - source[2], shift), 0), MAX_LOG)
        shift = shift_of(bases, S_SCALE2, level, 2 * s0 - long, long, ZERO, opacity, BITS - 1)
        thin = _rounded(thinness_of(max(s0 - long - source[3], 0), thinness), shift)
        thin = min(max(thin, 0), (MAX_THIN >> shift) << shift)
        shifts[i] = place_shift(bases, level, s0, long, thinness[thin], opacity, unit, coarsest)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _rounded(value, shift):
    return ((value + ((1 << shift) >> 1)) >> shift) << shift
