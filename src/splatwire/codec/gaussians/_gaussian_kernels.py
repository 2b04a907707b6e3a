"""Numba kernels that encode or decode a Gaussian, predicted from its nearest preceding neighbours in the packet."""

from typing import no_type_check

import numpy as np

from splatwire.codec._coder_kernels import code_bit, code_value
from splatwire.codec._step_kernels import position_shift, step_shift
from splatwire.codec.gaussians._neighbour_kernels import (
    BIT_LENGTHS,
    LUMA_VALUE,
    deviation_context_of,
)
from splatwire.codec.gaussians.layout import (
    ASSUMED_ELONGATION,
    BITS,
    FIRST_CLASS,
    LUMA,
    MAX_CLASSES,
    MAX_COLOUR,
    MAX_COMPANDED,
    MAX_LOG,
    MAX_LOG_OPACITY,
    MIN_LOG_OPACITY,
    NUM_MAGNITUDE_CONTEXTS,
    OPACITY,
    RESIDUAL_ELONGATION,
    RESIDUAL_FLATNESS,
    RESIDUAL_LUMA,
    RESIDUAL_OPACITY,
    RESIDUAL_SCALE0,
    STEP_COLOUR,
    STEP_ELONGATION,
    STEP_FLATNESS,
    STEP_OPACITY,
    STEP_SCALE0,
)
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit

LN2 = np.log(2.0)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def update_magnitude(residual_magnitude, steps):
    """Updates the moving average of residual magnitudes, which selects the context of the next residual.

    Args:
        residual_magnitude: Moving average of the preceding residuals, in sixteenths of a quantisation step.
        steps: Residual just coded, in quantisation steps.
    """
    return (residual_magnitude + (min(abs(steps), 1 << 14) << 4)) >> 1


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def magnitude_context_of(residual_magnitude):
    """Returns the entropy coder's context for a residual, given the average magnitude of preceding residuals.

    Args:
        residual_magnitude: The average, in sixteenths of a quantisation step.
    """
    # The context grows with the logarithm of the average.
    if residual_magnitude < 256:
        return BIT_LENGTHS[residual_magnitude]
    return min(8 + BIT_LENGTHS[min(residual_magnitude >> 8, 255)], NUM_MAGNITUDE_CONTEXTS - 1)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_class(coder, context, value):
    """Encodes or decodes the precision class (set of quantisation steps) of a Gaussian; returns the class.

    Args:
        coder: Entropy coder.
        context: Context of the entropy coder.
        value: The class; only used by an encoder.
    """
    base, node = FIRST_CLASS + context * MAX_CLASSES, 1
    for shift in range(2, -1, -1):
        node = 2 * node + code_bit(coder, base + node, (value >> shift) & 1)
    return node - MAX_CLASSES


@njit(borrows=True, error_model="numpy")
@no_type_check
def compand_flatness(ratio, flatness_table):
    """Quantises the ratio of a Gaussian's second to third scale to the nearest entry of a non-uniform table.

    Args:
        ratio: Base-2 logarithm of the ratio, in fixed point.
        flatness_table: The table, ascending, from `flatness_table`.

    Returns:
        Index of the entry.
    """
    # The formula of the table gives the entry or one next to it, several times as fast as a binary search.
    last = len(flatness_table) - 1
    low = min(np.int64((1.0 - np.exp2(ratio * (-1.0 / (1 << BITS)))) * ((1 << BITS) / LN2)), last)
    while low > 0 and flatness_table[low - 1] >= ratio:
        low -= 1
    while low < last and flatness_table[low] < ratio:
        low += 1
    return low - 1 if low and ratio - flatness_table[low - 1] < flatness_table[low] - ratio else low


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_logs(
    coder, row, source, base_exponents, precision_class, neighbours, num_neighbours, flatness_table, absolute
):
    """Encodes or decodes opacity and scales of a Gaussian, predicted from neighbours.

    Args:
        coder: Entropy coder.
        row: Decoded integers of the Gaussian, int64 (columns); opacity and scales are written.
        source: Logarithms of opacity and scales, int64 (4); only used by an encoder.
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        precision_class: Precision class of the Gaussian; the steps of class c + 1 are half as large as those of class
            c.
        neighbours: Working arrays of the packet (`Neighbours`), with means and deviations of the neighbours'
            attributes.
        num_neighbours: Number of neighbours.
        flatness_table: Table for decoding the ratio of two scales, from `flatness_table`.
        absolute: True to quantise the value; False, in side information of version 2, to quantise its difference from
            the prediction.

    Returns:
        Five integers. The first four are decoded logarithms: of the largest scale, of the ratio of the largest to the
        second scale, of the ratio of the second to the smallest scale, and of the opacity. The fifth is the moving
        average of residual magnitudes, in 16ths of a quantisation step.
    """
    s0 = elongation = companded = opacity = np.int64(0)
    residual_magnitude = np.int64(16)
    # A loop, because numba would compile a copy of the entropy coder for each call. `kind` is an index in both
    # `RESIDUAL_KINDS` and `STEPS`: their first four entries are the same quantities.
    for kind in range(4):
        mean, value, area = neighbours.means[kind], source[kind], np.int64(0)
        low, high, max_shift = np.int64(0), np.int64(MAX_LOG), np.int64(BITS - 1)
        if kind == RESIDUAL_OPACITY:
            value = value + 1 if value == MAX_LOG_OPACITY else value
            low, high, max_shift = np.int64(MIN_LOG_OPACITY), np.int64(MAX_LOG_OPACITY), np.int64(BITS)
        elif kind == RESIDUAL_SCALE0:
            area = ZERO if absolute else 2 * mean - ASSUMED_ELONGATION
            low = np.int64(-MAX_LOG)
        elif kind == RESIDUAL_ELONGATION:
            area, value = 2 * s0 - ASSUMED_ELONGATION, s0 - value
        else:
            area = 2 * s0 - elongation
            value = ZERO if coder.decoding else compand_flatness(max(s0 - elongation - value, 0), flatness_table)
        # The quantisation step of each value depends on the values decoded before.
        shift = step_shift(base_exponents, kind, precision_class, area, elongation, ZERO, opacity, max_shift)
        deviation_context = deviation_context_of(num_neighbours, neighbours.deviations[kind], shift)
        magnitude_context = shift if kind < RESIDUAL_ELONGATION else magnitude_context_of(residual_magnitude)
        value, steps = code_value(coder, kind, deviation_context, magnitude_context, mean, value, shift, absolute)
        residual_magnitude = update_magnitude(residual_magnitude, steps)
        if kind == RESIDUAL_FLATNESS:
            high = np.int64((MAX_COMPANDED >> shift) << shift if absolute else MAX_COMPANDED)
        value = min(max(value, low), high)
        row[OPACITY + kind] = value
        if kind == RESIDUAL_OPACITY:
            opacity = value
        elif kind == RESIDUAL_SCALE0:
            s0 = value
        elif kind == RESIDUAL_ELONGATION:
            elongation = value
        else:
            companded = value
    return s0, elongation, flatness_table[companded], opacity, residual_magnitude


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_colour(
    coder, row, source, base_exponents, precision_class, neighbours, num_neighbours, residual_magnitude, absolute
):
    """Encodes or decodes the base colour (Y Co Cg) of a Gaussian, predicted from neighbours.

    Args:
        coder: Entropy coder.
        row: Decoded integers of the Gaussian, int64 (columns); the colour is written.
        source: The exact colour, int64 (3); only used by an encoder.
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        precision_class: Precision class of the Gaussian; the steps of class c + 1 are half as large as those of class
            c.
        neighbours: Working arrays of the packet (`Neighbours`), with means and deviations of the neighbours'
            attributes.
        num_neighbours: Number of neighbours.
        residual_magnitude: Moving average of the magnitudes of preceding residuals, in 16ths of a quantisation step.
        absolute: True to quantise the value; False, in side information of version 2, to quantise its difference from
            the prediction.
    """
    shift = step_shift(base_exponents, STEP_COLOUR, precision_class, ZERO, ZERO, ZERO, ZERO, BITS - 2)
    for c in range(3):
        deviation_context, mean = (
            deviation_context_of(num_neighbours, neighbours.deviations[LUMA_VALUE + c], shift),
            neighbours.means[LUMA_VALUE + c],
        )
        value, steps = code_value(
            coder,
            RESIDUAL_LUMA + c,
            deviation_context,
            magnitude_context_of(residual_magnitude),
            mean,
            source[c],
            shift,
            absolute,
        )
        row[LUMA + c] = min(max(value, -MAX_COLOUR), MAX_COLOUR)
        residual_magnitude = update_magnitude(residual_magnitude, steps)


@njit(nogil=True, error_model="numpy")
@no_type_check
def position_shifts(logs, precision_classes, base_exponents, lattice_bits, max_position_shift, flatness_table, shifts):
    """Computes the quantisation step of each Gaussian's position, which depends on its rounded opacity and scales.

    Args:
        logs: Logarithms of opacity and scales, int64 (n, 4).
        precision_classes: Precision class of each Gaussian, which selects its quantisation steps, int64 (n).
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        max_position_shift: log2 of the largest quantisation step of positions, in lattice spacings.
        flatness_table: Table for decoding the ratio of two scales, from `flatness_table`.
        shifts: Output: log2 of the steps, in lattice spacings, int64 (n).
    """
    for i in range(len(logs)):
        precision_class, source = precision_classes[i], logs[i]
        shift = step_shift(base_exponents, STEP_OPACITY, precision_class, ZERO, ZERO, ZERO, ZERO, BITS)
        opacity = source[0] + 1 if source[0] == MAX_LOG_OPACITY else source[0]
        opacity = min(max(rounded(opacity, shift), MIN_LOG_OPACITY), MAX_LOG_OPACITY)
        shift = step_shift(base_exponents, STEP_SCALE0, precision_class, ZERO, ZERO, ZERO, opacity, BITS - 1)
        s0 = min(max(rounded(source[1], shift), -MAX_LOG), MAX_LOG)
        shift = step_shift(
            base_exponents, STEP_ELONGATION, precision_class, 2 * s0 - ASSUMED_ELONGATION, ZERO, ZERO, opacity, BITS - 1
        )
        elongation = min(max(rounded(s0 - source[2], shift), 0), MAX_LOG)
        shift = step_shift(
            base_exponents, STEP_FLATNESS, precision_class, 2 * s0 - elongation, elongation, ZERO, opacity, BITS - 1
        )
        companded = rounded(compand_flatness(max(s0 - elongation - source[3], 0), flatness_table), shift)
        companded = min(max(companded, 0), (MAX_COMPANDED >> shift) << shift)
        shifts[i] = position_shift(
            base_exponents,
            precision_class,
            s0,
            elongation,
            flatness_table[companded],
            opacity,
            lattice_bits,
            max_position_shift,
        )


@njit(borrows=True, error_model="numpy")
@no_type_check
def rounded(value, shift):
    """Rounds an integer to the nearest multiple of `2 ** shift`."""
    return ((value + ((1 << shift) >> 1)) >> shift) << shift
