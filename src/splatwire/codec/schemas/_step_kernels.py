"""Numba kernels of the steps in which Gaussians are quantised: what they are and what moves of them."""

from typing import no_type_check

from splatwire.codec.schemas.gaussians.layout import BITS, COEFFICIENTS, S_POSITION, STEP_BITS
from splatwire.ops.compiled import njit


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
def shift_of(bases, which, level, area, long, thin, opacity, most):
    """log2 of a step in units of the fixed point, from 0 to `most`."""
    return min(max(BITS - exponent(bases, which, level, area, long, thin, opacity), 0), most)


@njit(borrows=True, error_model="numpy")
@no_type_check
def place_shift(bases, level, s0, long, thin, opacity, unit, most):
    """log2 of the cell of a place, in lattice units, from 0 to `most`."""
    e = max(exponent(bases, S_POSITION, level, 2 * s0 - long, long, thin, opacity), 1 - ((s0 - long) >> BITS))
    return min(max(unit - e, 0), most)
