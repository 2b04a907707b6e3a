"""Numba kernels of the quantisation steps of Gaussians and their motion."""

from typing import no_type_check

from splatwire.codec.gaussians.layout import BITS, COEFFICIENTS, STEP_BITS, STEP_POSITION
from splatwire.ops.compiled import njit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def step_exponent(base_exponents, attribute, precision_class, area, elongation, flatness, opacity):
    """Computes `-log2` of the quantisation step of one attribute of a Gaussian, as an integer.

    Args:
        base_exponents: `-log2` of each attribute's quantisation step in precision class 0, for a Gaussian with scales
            and opacity 1; `STEP_BITS` fractional bits.
        attribute: Index of the attribute in `gaussians.layout.STEPS`.
        precision_class: Precision class of the Gaussian, 0 for the coarsest. Quantisation steps halve from each class
            to the next.
        area: log2 of the product of the two largest scales, `BITS` fractional bits.
        elongation: log2 of the ratio of the largest to the second scale, `BITS` fractional bits.
        flatness: log2 of the ratio of the second to the third scale, `BITS` fractional bits.
        opacity: log2 of the opacity, `BITS` fractional bits.
    """
    # The result grows by one from each precision class to the next higher one. It also depends linearly on the
    # logarithms of the scales and of the opacity.
    c = COEFFICIENTS[attribute]
    sums = c[0] * area + c[1] * elongation + c[2] * flatness + c[3] * opacity
    sums += (base_exponents[attribute] + (precision_class << STEP_BITS)) << BITS
    return (sums + (1 << (BITS + STEP_BITS - 1))) >> (BITS + STEP_BITS)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def step_shift(base_exponents, attribute, precision_class, area, elongation, flatness, opacity, max_shift):
    """Computes log2 of the quantisation step of one attribute of a Gaussian, limited to the range of the format.

    Args:
        base_exponents: `-log2` of each attribute's quantisation step in precision class 0, `STEP_BITS` fractional bits.
        attribute: Index of the attribute in `gaussians.layout.STEPS`.
        precision_class: Precision class of the Gaussian, 0 for the coarsest. Quantisation steps halve from each class
            to the next.
        area: log2 of the product of the two largest scales, `BITS` fractional bits.
        elongation: log2 of the ratio of the largest to the second scale, `BITS` fractional bits.
        flatness: log2 of the ratio of the second to the third scale, `BITS` fractional bits.
        opacity: log2 of the opacity, `BITS` fractional bits.
        max_shift: Upper limit on the result.

    Returns:
        log2 of the ratio of the step to `2**-BITS`, 0 to `max_shift`.
    """
    return min(
        max(BITS - step_exponent(base_exponents, attribute, precision_class, area, elongation, flatness, opacity), 0),
        max_shift,
    )


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def position_shift(base_exponents, precision_class, s0, elongation, flatness, opacity, lattice_bits, max_shift):
    """Computes log2 of the quantisation step of a Gaussian's position.

    The step is at most half the Gaussian's second-largest scale, but at least one lattice spacing.

    Args:
        base_exponents: `-log2` of each attribute's quantisation step in precision class 0, `STEP_BITS` fractional bits.
        precision_class: Precision class of the Gaussian, 0 for the coarsest. Quantisation steps halve from each class
            to the next.
        s0: log2 of the largest of the three scales, `BITS` fractional bits.
        elongation: log2 of the ratio of the largest to the second scale, `BITS` fractional bits.
        flatness: log2 of the ratio of the second to the third scale, `BITS` fractional bits.
        opacity: log2 of the opacity, `BITS` fractional bits.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        max_shift: Upper limit on the result.

    Returns:
        log2 of the step in lattice spacings, 0 to `max_shift`.
    """
    # `1 - floor(log2 s1)` is the exponent of a step of at most half the second scale s1.
    exponent = step_exponent(
        base_exponents, STEP_POSITION, precision_class, 2 * s0 - elongation, elongation, flatness, opacity
    )
    e = max(exponent, 1 - ((s0 - elongation) >> BITS))
    return min(max(lattice_bits - e, 0), max_shift)
