"""Numba kernels that encode or decode the spherical harmonics of a Gaussian."""

from typing import no_type_check

import numpy as np

from splatwire.bitstream.limits import MAX_DEGREE
from splatwire.codec._coder_kernels import code_bit, code_escape, code_flag
from splatwire.codec._step_kernels import step_exponent
from splatwire.codec.gaussians.layout import (
    BITS,
    FIRST_HARMONIC,
    FIRST_MAGNITUDE,
    MAX_CLASSES,
    MAX_HARMONIC,
    STEP_HARMONICS,
)
from splatwire.entropy.range_kernels import ONE, ZERO
from splatwire.ops.compiled import njit

MAGNITUDE_BOUNDS = np.array([0, 2, 6, 13, 24, 42, 74, 135], dtype=np.int64)
"""Lower bound of each context of a harmonic, in sixteenths of a quantisation step. The context depends
on a decaying sum of the preceding harmonics' magnitudes, which keeps 13/16 with each harmonic.
"""
MAGNITUDE_CONTEXTS = np.searchsorted(MAGNITUDE_BOUNDS, np.arange(MAGNITUDE_BOUNDS[-1] + 1), side="right") - 1
"""Context of a harmonic for each value of the decaying sum up to the last lower bound, int64."""
INDEX_CONTEXTS = np.array(
    [2 * np.searchsorted([3, 9, 21], j, side="right") + (j % 3 > 0) for j in range(3 * ((MAX_DEGREE + 1) ** 2 - 1))]
)
"""Context of a harmonic by its place in the order of coding, int64: group of coefficients, luma or chroma."""


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_harmonics(coder, values, source, base_exponents, precision_class):
    """Encodes or decodes the transformed spherical harmonics of a Gaussian, as integers.

    The transform decorrelates the harmonics in the colour space Y Co Cg (see `SideInfo.transform`).

    Args:
        coder: Entropy coder.
        values: Output: decoded transformed harmonics of the Gaussian, int32 (harmonics).
        source: Transformed harmonics before quantisation, int32 (harmonics); only used by an encoder.
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        precision_class: Precision class of the Gaussian; the steps of class c + 1 are half as large as those of class
            c.
    """
    # The order is by coefficient: Y, Co, Cg of the first, then of the second, and so on. The context of a harmonic is
    # the magnitude of the harmonics coded before it for the same Gaussian.
    shift = min(
        max(BITS - step_exponent(base_exponents, STEP_HARMONICS, precision_class, ZERO, ZERO, ZERO, ZERO), 0), BITS - 2
    )
    half_step = (1 << shift) >> 1
    has_nonzero = 0
    if not coder.decoding:
        for j in range(len(values)):
            values[j] = (source[j] + half_step) >> shift
            has_nonzero |= values[j] != 0
    has_nonzero = code_bit(coder, FIRST_HARMONIC + precision_class, np.int64(has_nonzero))
    magnitude_sum = np.int64(0)
    if not has_nonzero:
        for j in range(len(values)):
            values[j] = 0
        return
    for j in range(len(values)):
        context = MAGNITUDE_CONTEXTS[min(magnitude_sum, len(MAGNITUDE_CONTEXTS) - 1)]
        value = np.int64(values[j]) if not coder.decoding else np.int64(0)
        value = _code_harmonic(coder, value, FIRST_HARMONIC + MAX_CLASSES + 8 * context + INDEX_CONTEXTS[j], context)
        values[j] = min(max(value << shift, -MAX_HARMONIC), MAX_HARMONIC)
        magnitude_sum = ((magnitude_sum * 13) >> 4) + (min(abs(value), 1 << 16) << 4)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_harmonic(coder, value, zero_context, magnitude_context):
    """Encodes or decodes one harmonic in quantisation steps; returns it. A decoder ignores `value`."""
    if not code_bit(coder, zero_context, ONE if value != 0 else ZERO):
        return np.int64(0)
    negative = code_flag(coder, ONE if value < 0 else ZERO)
    magnitude, base = abs(value), FIRST_MAGNITUDE + magnitude_context * 3
    decoded = np.int64(1)
    while decoded < 15:
        if not code_bit(coder, base + min(decoded - 1, 2), ONE if magnitude > decoded else ZERO):
            return -decoded if negative else decoded
        decoded += 1
    decoded += min(code_escape(coder, magnitude - decoded), 1 << 20)
    return -decoded if negative else decoded
