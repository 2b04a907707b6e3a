"""Numba kernels of the quantisation steps of Gaussians and their motion."""

from typing import no_type_check

from splatwire.codec.gaussians.layout import BITS, COEFFICIENTS, S_POSITION, STEP_BITS
from splatwire.ops.compiled import njit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def exponent(bases, which, level, area, long, thin, opacity):
    """Returns `-log2` of the quantisation step of one quantity of a Gaussian, rounded.

    Args:
        bases: Exponents of the lowest precision class, by quantity, `STEP_BITS` fractional bits.
        which: Index of the quantity in `gaussians.layout.STEPS`.
        level: Precision class of the Gaussian, 0 for the lowest.
        area: log2 of the product of the two largest scales, in fixed point (`BITS` fractional bits, as the following).
        long: log2 of the ratio of the largest to the second scale.
        thin: log2 of the ratio of the second to the third scale.
        opacity: log2 of the opacity.
    """
    c = COEFFICIENTS[which]
    sums = c[0] * area + c[1] * long + c[2] * thin + c[3] * opacity
    sums += (bases[which] + (level << STEP_BITS)) << BITS
    return (sums + (1 << (BITS + STEP_BITS - 1))) >> (BITS + STEP_BITS)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def shift_of(bases, which, level, area, long, thin, opacity, most):
    """Returns log2 of a quantisation step in units of `2**-BITS`, clipped to 0 to `most`.

    Args:
        bases: Exponents of the lowest precision class, by quantity, `STEP_BITS` fractional bits.
        which: Index of the quantity in `gaussians.layout.STEPS`.
        level: Precision class of the Gaussian, 0 for the lowest.
        area: log2 of the product of the two largest scales, in fixed point (`BITS` fractional bits, as the following).
        long: log2 of the ratio of the largest to the second scale.
        thin: log2 of the ratio of the second to the third scale.
        opacity: log2 of the opacity.
        most: Maximum result.
    """
    return min(max(BITS - exponent(bases, which, level, area, long, thin, opacity), 0), most)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def place_shift(bases, level, s0, long, thin, opacity, unit, most):
    """Returns log2 of the quantisation step of a position in lattice units, clipped to the range from 0 to `most`.

    Args:
        bases: Exponents of the lowest precision class, by quantity, `STEP_BITS` fractional bits.
        level: Precision class of the Gaussian, 0 for the lowest.
        s0: log2 of the largest scale, in fixed point (`BITS` fractional bits, as the following).
        long: log2 of the ratio of the largest to the second scale.
        thin: log2 of the ratio of the second to the third scale.
        opacity: log2 of the opacity.
        unit: `-log2` of the lattice spacing, relative to the scene's size.
        most: Maximum result.
    """
    e = max(exponent(bases, S_POSITION, level, 2 * s0 - long, long, thin, opacity), 1 - ((s0 - long) >> BITS))
    return min(max(unit - e, 0), most)
