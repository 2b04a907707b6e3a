"""Numba kernels that code an integer under a normal distribution or a mixture of two."""
# `tests/reference/range_coder.py` is the same in plain Python.

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import (
    ONE,
    ZERO,
    decode_advance,
    decode_raw,
    decode_target,
    encode_interval,
    encode_raw,
)
from splatwire.entropy.tables import INVERSE_BITS, MEAN_BITS, TOTAL_BITS, Z_BITS, Z_CELL_BITS, Z_LIMIT
from splatwire.ops.compiled import njit

TOTAL = np.int64(1 << TOTAL_BITS)
ESCAPE = np.int64(16)
Z_SHIFT = MEAN_BITS + INVERSE_BITS - Z_BITS
Z_CLIP = Z_LIMIT << Z_BITS
Z_FRACTION = (1 << Z_CELL_BITS) - 1
HALF_STEP = 1 << (MEAN_BITS - 1)
SYMBOL_BITS = np.int64(TOTAL_BITS)
NORMAL = np.int64(1 << 16)
"""Weight that makes a mixture a plain normal."""


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def normal_cdf(boundary, mean, inverse, table):
    """Returns the CDF of a normal distribution in units of 2**-24.

    Args:
        boundary: Argument of the CDF, in quantisation steps with `MEAN_BITS` fractional bits.
        mean: Mean of the distribution, in the same units.
        inverse: Reciprocal of the standard deviation, from `inverse_scale_table`.
        table: Standard normal CDF, from `normal_table`.
    """
    z = ((boundary - mean) * inverse) >> Z_SHIFT
    if z <= -Z_CLIP:
        return ZERO
    if z >= Z_CLIP:
        return TOTAL
    z += Z_CLIP
    cell = z >> Z_CELL_BITS
    base = table[cell]
    return base + (((table[cell + 1] - base) * (z & Z_FRACTION)) >> Z_CELL_BITS)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def cumulative(symbol, low, high, mean0, inverse0, mean1, inverse1, weight, table):
    """Returns the start of a symbol's probability interval, in units of 2**-24.

    Args:
        symbol: The symbol, from `low` to `high + 1`; `high + 1` stands for the escape code.
        low: First integer with a probability interval, from `window`.
        high: Last integer with a probability interval.
        mean0: Mean of the first component, see `entropy.coder.Mixtures`.
        inverse0: Reciprocal of the standard deviation of the first component.
        mean1: Mean of the second component.
        inverse1: Reciprocal of the standard deviation of the second component.
        weight: Weight of the first component, out of 2**16; 2**16 for a single normal distribution.
        table: Standard normal CDF, from `normal_table`.
    """
    # The interval ends at the start of the next one. Each is enlarged by one unit, so that none is empty.
    if symbol <= low:
        return ZERO
    count = high - low + 1
    if symbol > high:
        return TOTAL - ESCAPE
    boundary = (symbol << MEAN_BITS) - HALF_STEP
    below = normal_cdf(boundary, mean0, inverse0, table)
    if weight < NORMAL:
        below = (below * weight + normal_cdf(boundary, mean1, inverse1, table) * (65536 - weight)) >> 16
    return ((below * (TOTAL - ESCAPE - count)) >> TOTAL_BITS) + (symbol - low)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def window(mean0, scale0, mean1, scale1, weight, widths):
    """Returns the range of integers that need no escape code under a distribution.

    Args:
        mean0: Mean of the first component, see `entropy.coder.Mixtures`.
        scale0: Standard deviation of the first component, an index into the scale table.
        mean1: Mean of the second component.
        scale1: Standard deviation of the second component.
        weight: Weight of the first component, out of 2**16; 2**16 for a single normal distribution.
        widths: Largest distance from the mean that needs no escape code, by scale index, from `half_width_table`.

    Returns:
        First and last integer of the range.
    """
    center = (mean0 + HALF_STEP) >> MEAN_BITS
    low = center - widths[scale0]
    high = center + widths[scale0]
    if weight < NORMAL:
        center = (mean1 + HALF_STEP) >> MEAN_BITS
        low = min(low, center - widths[scale1])
        high = max(high, center + widths[scale1])
        if high - low > 32767:
            low, high = center - 16383, center + 16383
    return low, high


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def encode_escape(buffer, state, excess):
    """Encodes a non-negative integer in Elias gamma code, for a symbol far from the mean of its distribution.

    Args:
        buffer: Output bytes of the range encoder.
        state: State of the range encoder, see `range_kernels`.
        excess: The integer: distance of the symbol from the range of symbols that need no escape code, minus 1.
    """
    value = excess + 1
    length = 0
    while value >> (length + 1):
        length += 1
    for _ in range(length):
        encode_raw(buffer, state, ONE)
    encode_raw(buffer, state, ZERO)
    for i in range(length - 1, -1, -1):
        encode_raw(buffer, state, (value >> i) & 1)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_escape(data, end, state):
    """Decodes a non-negative integer written by `encode_escape`.

    Args:
        data: Input bytes.
        end: End of the code in `data`.
        state: State of the range decoder, changed in place.
    """
    # The length is limited, because damaged bytes may contain any number of ones.
    length = 0
    while length < 32 and decode_raw(data, end, state):
        length += 1
    value = 1
    for _ in range(length):
        value = (value << 1) | decode_raw(data, end, state)
    return value - 1


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def encode_symbol(buffer, state, symbol, mean0, scale0, mean1, scale1, weight, inverses, widths, table):
    """Encodes one integer under a normal distribution or a mixture of two.

    Args:
        buffer: Output bytes of the range encoder.
        state: State of the range encoder, see `range_kernels`.
        symbol: The integer.
        mean0: Mean of the first component, see `entropy.coder.Mixtures`.
        scale0: Standard deviation of the first component, an index into the scale table.
        mean1: Mean of the second component.
        scale1: Standard deviation of the second component.
        weight: Weight of the first component, out of 2**16; 2**16 for a single normal distribution.
        inverses: Reciprocals of the standard deviations, by scale index.
        widths: Largest distance from the mean that needs no escape code, by scale index.
        table: Standard normal CDF, from `normal_table`.
    """
    low, high = window(mean0, scale0, mean1, scale1, weight, widths)
    if low <= symbol <= high:
        a = cumulative(symbol, low, high, mean0, inverses[scale0], mean1, inverses[scale1], weight, table)
        b = cumulative(symbol + 1, low, high, mean0, inverses[scale0], mean1, inverses[scale1], weight, table)
        encode_interval(buffer, state, a, b - a, SYMBOL_BITS)
        return
    encode_interval(buffer, state, TOTAL - ESCAPE, ESCAPE, SYMBOL_BITS)
    above = 1 if symbol > high else 0
    encode_raw(buffer, state, above)
    encode_escape(buffer, state, symbol - high - 1 if above else low - 1 - symbol)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_symbol(data, end, state, mean0, scale0, mean1, scale1, weight, inverses, widths, table):
    """Decodes one integer written by `encode_symbol`, given the same distribution as for encoding.

    Args:
        data: Input bytes of the range decoder.
        end: End of the code in `data` (exclusive).
        state: State of the range decoder, changed in place.
        mean0: Mean of the first component, see `entropy.coder.Mixtures`.
        scale0: Standard deviation of the first component, an index into the scale table.
        mean1: Mean of the second component.
        scale1: Standard deviation of the second component.
        weight: Weight of the first component, out of 2**16; 2**16 for a single normal distribution.
        inverses: Reciprocals of the standard deviations, by scale index.
        widths: Largest distance from the mean that needs no escape code, by scale index.
        table: Standard normal CDF, from `normal_table`.
    """
    # The search starts at the mean of the component with the larger weight. It proceeds outwards in doubling steps
    # until the symbol is enclosed, and ends with a bisection.
    low, high = window(mean0, scale0, mean1, scale1, weight, widths)
    target = decode_target(state, SYMBOL_BITS)
    if target >= TOTAL - ESCAPE:
        decode_advance(data, end, state, TOTAL - ESCAPE, ESCAPE, SYMBOL_BITS)
        above = decode_raw(data, end, state)
        excess = decode_escape(data, end, state)
        return high + 1 + excess if above else low - 1 - excess
    i0, i1 = inverses[scale0], inverses[scale1]
    guess = ((mean0 if weight >= 32768 else mean1) + HALF_STEP) >> MEAN_BITS
    guess = min(max(guess, low), high)
    a = cumulative(guess, low, high, mean0, i0, mean1, i1, weight, table)
    jump = np.int64(1)
    if target >= a:
        left, left_value = guess, a
        right = guess + 1
        right_value = cumulative(right, low, high, mean0, i0, mean1, i1, weight, table)
        while target >= right_value:
            left, left_value = right, right_value
            jump <<= 1
            right = min(right + jump, high + 1)
            right_value = cumulative(right, low, high, mean0, i0, mean1, i1, weight, table)
    else:
        right, right_value = guess, a
        left = max(guess - 1, low)
        left_value = cumulative(left, low, high, mean0, i0, mean1, i1, weight, table)
        while target < left_value:
            right, right_value = left, left_value
            jump <<= 1
            left = max(left - jump, low)
            left_value = cumulative(left, low, high, mean0, i0, mean1, i1, weight, table)
    while right - left > 1:
        middle = (left + right) >> 1
        value = cumulative(middle, low, high, mean0, i0, mean1, i1, weight, table)
        if target >= value:
            left, left_value = middle, value
        else:
            right, right_value = middle, value
    decode_advance(data, end, state, left_value, right_value - left_value, SYMBOL_BITS)
    return left
