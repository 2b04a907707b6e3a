"""Numba kernel that quantises Gaussians without coding them."""

from typing import no_type_check

import numpy as np

from splatwire.codec._step_kernels import position_shift, step_exponent, step_shift
from splatwire.codec.gaussians._axis_kernels import largest_of, round_axis
from splatwire.codec.gaussians._gaussian_kernels import compand_flatness, rounded
from splatwire.codec.gaussians._packet_kernels import spin_angle
from splatwire.codec.gaussians.layout import (
    ASSUMED_ELONGATION,
    AXIS,
    BITS,
    CLASS,
    DIRECTION_BITS,
    ELONGATION,
    FLATNESS,
    LUMA,
    MAX_COLOUR,
    MAX_COMPANDED,
    MAX_HARMONIC,
    MAX_LOG,
    MAX_LOG_OPACITY,
    MIN_LOG_OPACITY,
    OPACITY,
    POSITION,
    PRIMARY,
    SCALE0,
    SPIN,
    SPIN_BITS,
    STEP_COLOUR,
    STEP_DIRECTION,
    STEP_ELONGATION,
    STEP_FLATNESS,
    STEP_HARMONICS,
    STEP_OPACITY,
    STEP_SCALE0,
    STEP_SPIN,
)
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit


@njit(nogil=True, error_model="numpy")
@no_type_check
def round_rows(
    positions,
    logs,
    axes,
    colours,
    precision_classes,
    base_exponents,
    lattice_bits,
    max_position_shift,
    flatness_table,
    harmonics,
    rows,
):
    """Quantises n Gaussians to the integers that a decoder would obtain, without encoding them.

    Positions are multiples of a small distance, the spacing of the position lattice.

    Args:
        positions: Positions in lattice spacings, int64 (n, 3).
        logs: log2 of the opacity, then of the scales relative to the scene size, largest first, in fixed point with
            `BITS` fractional bits, int64 (n, 4).
        axes: Principal axes as columns, in the order of decreasing scale, float64 (n, 3, 3).
        colours: Base colours as Y Co Cg, in fixed point with `BITS` fractional bits, int64 (n, 3).
        precision_classes: Precision class of each Gaussian, which selects its quantisation steps, int64 (n); 0 is the
            coarsest.
        base_exponents: `-log2` of the quantisation step of each quantity in `layout.STEPS`, for precision class 0, in
            fixed point with `STEP_BITS` fractional bits, int64 (9).
        lattice_bits: `-log2` of the lattice spacing, as a share of the scene size.
        max_position_shift: log2 of the largest quantisation step of positions, in lattice spacings.
        flatness_table: Table that decodes the ratio of the second to the third scale, from `flatness_table`.
        harmonics: Spherical harmonics after the transform that decorrelates them, int32 (n, harmonics); replaced by the
            rounded values.
        rows: Output: decoded integers of each Gaussian except harmonics, int64 (n, columns); columns as in `layout`.
            Positions are in halves of the lattice spacing, relative to the origin of the lattice.
    """
    axis = np.zeros(3, np.int64)
    for i in range(len(rows)):
        row, precision_class = rows[i], precision_classes[i]
        row[CLASS] = precision_class
        value = logs[i, 0] + 1 if logs[i, 0] == MAX_LOG_OPACITY else logs[i, 0]
        shift = step_shift(base_exponents, STEP_OPACITY, precision_class, ZERO, ZERO, ZERO, ZERO, BITS)
        opacity = min(max(rounded(value, shift), MIN_LOG_OPACITY), MAX_LOG_OPACITY)
        shift = step_shift(base_exponents, STEP_SCALE0, precision_class, ZERO, ZERO, ZERO, opacity, BITS - 1)
        s0 = min(max(rounded(logs[i, 1], shift), -MAX_LOG), MAX_LOG)
        shift = step_shift(
            base_exponents, STEP_ELONGATION, precision_class, 2 * s0 - ASSUMED_ELONGATION, ZERO, ZERO, opacity, BITS - 1
        )
        elongation = min(max(rounded(s0 - logs[i, 2], shift), 0), MAX_LOG)
        area = 2 * s0 - elongation
        shift = step_shift(base_exponents, STEP_FLATNESS, precision_class, area, elongation, ZERO, opacity, BITS - 1)
        companded = rounded(compand_flatness(max(s0 - elongation - logs[i, 3], 0), flatness_table), shift)
        companded = min(max(companded, 0), (MAX_COMPANDED >> shift) << shift)
        flatness = flatness_table[companded]
        row[OPACITY], row[SCALE0], row[ELONGATION], row[FLATNESS] = opacity, s0, elongation, companded
        shift = position_shift(
            base_exponents, precision_class, s0, elongation, flatness, opacity, lattice_bits, max_position_shift
        )
        for a in range(3):
            row[POSITION + a] = (2 * (positions[i, a] >> shift) + 1) << shift
        row[PRIMARY] = primary = 2 if flatness >= elongation else 0
        e = step_exponent(base_exponents, STEP_DIRECTION, precision_class, area, elongation, flatness, opacity)
        round_axis(axes[i, :, primary], min(max(DIRECTION_BITS - e, 0), DIRECTION_BITS - 2), axis)
        sign = -1 if axis[largest_of(axis)] < 0 else 1
        for a in range(3):
            row[AXIS + a] = sign * axis[a]
        e = step_exponent(base_exponents, STEP_SPIN, precision_class, area, elongation, flatness, opacity)
        bits = min(max(e, 0), DIRECTION_BITS)
        turn = np.int64(np.rint(spin_angle(row, axes[i], primary) / np.pi * (1 << bits)))
        row[SPIN_BITS], row[SPIN] = bits, turn & ((1 << bits) - 1)
        shift = step_shift(base_exponents, STEP_COLOUR, precision_class, ZERO, ZERO, ZERO, ZERO, BITS - 2)
        for c in range(3):
            row[LUMA + c] = min(max(rounded(colours[i, c], shift), -MAX_COLOUR), MAX_COLOUR)
        shift = min(
            max(BITS - step_exponent(base_exponents, STEP_HARMONICS, precision_class, ZERO, ZERO, ZERO, ZERO), 0),
            BITS - 2,
        )
        for k in range(harmonics.shape[1]):
            harmonics[i, k] = min(max(rounded(np.int64(harmonics[i, k]), shift), -MAX_HARMONIC), MAX_HARMONIC)
