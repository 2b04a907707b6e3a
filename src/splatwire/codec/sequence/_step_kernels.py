"""Numba kernel that computes the quantisation steps of motion."""

from typing import no_type_check

from splatwire.codec._step_kernels import position_shift, step_exponent, step_shift
from splatwire.codec.gaussians.layout import (
    ASSUMED_ELONGATION,
    BITS,
    DIRECTION_BITS,
    STEP_COLOUR,
    STEP_DIRECTION,
    STEP_ELONGATION,
    STEP_FLATNESS,
    STEP_OPACITY,
    STEP_SCALE0,
)
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit


@njit(nogil=True, error_model="numpy")
@no_type_check
def keyframe_shifts(columns, base_exponents, lattice_bits, max_position_shift, flatness_table, shifts):
    """Computes the quantisation steps of keyframe Gaussians, from which the steps of their motion are derived.

    Args:
        columns: Decoded integers of each keyframe Gaussian: `CLASS`, `OPACITY`, `SCALE0`, `ELONGATION` and
            `FLATNESS`, int64 (n, 5).
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        max_position_shift: log2 of the largest quantisation step of positions, in lattice spacings.
        flatness_table: Table for decoding the ratio of two scales, from `flatness_table`.
        shifts: Output: log2 of the steps, by channel of motion, int64 (n, channels).
    """
    for i in range(len(columns)):
        precision_class, opacity, s0, elongation = columns[i, 0], columns[i, 1], columns[i, 2], columns[i, 3]
        flatness = flatness_table[columns[i, 4]]
        area = 2 * s0 - elongation
        step_shift_in_lattice = position_shift(
            base_exponents, precision_class, s0, elongation, flatness, opacity, lattice_bits, max_position_shift
        )
        rotation_shift = DIRECTION_BITS - step_exponent(
            base_exponents, STEP_DIRECTION, precision_class, area, elongation, flatness, opacity
        )
        for a in range(3):
            # in half lattice spacings; the caller converts to the unit of motion
            shifts[i, a] = step_shift_in_lattice + 1
            shifts[i, 3 + a] = min(max(rotation_shift, 0), DIRECTION_BITS - 2)
        expected_area = 2 * s0 - ASSUMED_ELONGATION  # of a Gaussian of unknown elongation
        shifts[i, 6] = step_shift(base_exponents, STEP_SCALE0, precision_class, ZERO, ZERO, ZERO, opacity, BITS - 1)
        shifts[i, 7] = step_shift(
            base_exponents, STEP_ELONGATION, precision_class, expected_area, ZERO, ZERO, opacity, BITS - 1
        )
        # The ratio to the second scale is companded: its logarithm is coarser for thin Gaussians.
        flatness_shift = step_shift(
            base_exponents, STEP_FLATNESS, precision_class, area, elongation, ZERO, opacity, BITS - 1
        )
        shifts[i, 8] = min(flatness_shift + (flatness >> BITS), BITS - 1)
        shifts[i, 9] = step_shift(base_exponents, STEP_OPACITY, precision_class, ZERO, ZERO, ZERO, ZERO, BITS)
        colour = step_shift(base_exponents, STEP_COLOUR, precision_class, ZERO, ZERO, ZERO, ZERO, BITS - 2)
        shifts[i, 10] = shifts[i, 11] = shifts[i, 12] = colour
