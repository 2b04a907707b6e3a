"""Numba kernels of the range coder; `splatwire.entropy.reference` says the same in plain Python.

State of one coder is an int64 row: encoder `[low, range, position]`, decoder `[code, range, position]`. Numbers stay
below 2**49, so signed 64-bit arithmetic never overflows.

numba compiles a function anew for each combination of types that it is called with, and takes a literal number for a
type of its own. So these are called with int64 throughout: what comes out of narrower arrays is converted, and
constants are numpy's.
"""

from typing import no_type_check

import numpy as np

from splatwire.entropy.tables import (
    INVERSE_BITS,
    MEAN_BITS,
    TOTAL_BITS,
    Z_BITS,
    Z_CELL_BITS,
    Z_LIMIT,
)
from splatwire.ops.compiled import njit

TOP = 48
BOTTOM = 1 << 40
TOTAL = np.int64(1 << TOTAL_BITS)
ESCAPE = np.int64(16)
LOW_MASK = (1 << 40) - 1
Z_SHIFT = MEAN_BITS + INVERSE_BITS - Z_BITS
Z_CLIP = Z_LIMIT << Z_BITS
Z_FRACTION = (1 << Z_CELL_BITS) - 1
HALF_STEP = 1 << (MEAN_BITS - 1)

SYMBOL_BITS = np.int64(TOTAL_BITS)
ADAPTIVE_BITS = np.int64(16)
ZERO, ONE = np.int64(0), np.int64(1)
NORMAL = np.int64(1 << 16)
"""Weight that makes a mixture a plain normal."""

ADAPTIVE_SLOW = 7
ADAPTIVE_FAST = 4


@njit(error_model="numpy", forceinline=True)
@no_type_check
def encode_interval(buffer, state, start, size, total_bits):
    """Narrows the encoder to `[start, start + size)` out of `2**total_bits`."""
    unit = state[1] >> total_bits
    low = state[0] + unit * start
    span = unit * size
    position = state[2]
    if low >> TOP:
        low &= (1 << TOP) - 1
        back = position - 1
        while buffer[back] == 255:
            buffer[back] = 0
            back -= 1
        buffer[back] += 1
    while span < BOTTOM:
        buffer[position] = low >> 40
        position += 1
        low = (low & LOW_MASK) << 8
        span <<= 8
    state[0] = low
    state[1] = span
    state[2] = position


@njit(nogil=True, error_model="numpy")
@no_type_check
def encoder_start(state):
    """Puts a fresh encoder into `state`."""
    state[0] = 0
    state[1] = 1 << TOP
    state[2] = 0


@njit(nogil=True, error_model="numpy")
@no_type_check
def encoder_finish(buffer, state):
    """Writes the shortest tail that decodes right when followed by zero bytes; returns the length of the code."""
    low = state[0] + LOW_MASK
    position = state[2]
    if low >> TOP:
        back = position - 1
        while buffer[back] == 255:
            buffer[back] = 0
            back -= 1
        buffer[back] += 1
    buffer[position] = (low >> 40) & 255
    position += 1
    while position > 0 and buffer[position - 1] == 0:
        position -= 1
    return position


@njit(nogil=True, error_model="numpy")
@no_type_check
def decoder_start(data, begin, end, state):
    """Puts a decoder of `data[begin:end]` into `state`."""
    code = 0
    for i in range(6):
        code <<= 8
        if begin + i < end:
            code |= np.int64(data[begin + i])
    state[0] = code
    state[1] = 1 << TOP
    state[2] = begin + 6


@njit(error_model="numpy", forceinline=True)
@no_type_check
def decode_target(state, total_bits):
    """Number in `[0, 2**total_bits)` that the code points at."""
    return min(state[0] // (state[1] >> total_bits), (1 << total_bits) - 1)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def decode_advance(data, end, state, start, size, total_bits):
    """Removes `[start, start + size)` from the code and reads what is needed next; past `end` zeros are read."""
    unit = state[1] >> total_bits
    code = state[0] - unit * start
    span = unit * size
    position = state[2]
    while span < BOTTOM:
        code <<= 8
        if position < end:
            code |= np.int64(data[position])
        position += 1
        span <<= 8
    state[0] = code
    state[1] = span
    state[2] = position


@njit(error_model="numpy", forceinline=True)
@no_type_check
def encode_raw(buffer, state, bit):
    """Writes a bit that is as likely one as zero."""
    encode_interval(buffer, state, bit, ONE, ONE)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def decode_raw(data, end, state):
    """Reads a bit that is as likely one as zero."""
    bit = decode_target(state, ONE)
    decode_advance(data, end, state, bit, ONE, ONE)
    return bit


@njit(error_model="numpy", forceinline=True)
@no_type_check
def adaptive_update(model, context, bit):
    """Moves a model's two estimates of P(bit = 0), in units of 2**-16, one fast and one slow."""
    for column, rate in ((0, ADAPTIVE_SLOW), (1, ADAPTIVE_FAST)):
        p = model[context, column]
        model[context, column] = p - (p >> rate) if bit else p + ((65536 - p) >> rate)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def adaptive_size(model, context):
    """Size of the interval of a zero bit out of 2**16: the mean of the two estimates, kept off the ends."""
    p = (model[context, 0] + model[context, 1]) >> 1
    return min(max(p, 32), 65536 - 32)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def encode_bit(buffer, state, model, context, bit):
    """Codes one bit with an adaptive model and updates it."""
    zero = adaptive_size(model, context)
    if bit:
        encode_interval(buffer, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        encode_interval(buffer, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def decode_bit(data, end, state, model, context):
    """Decodes one bit with an adaptive model and updates it."""
    zero = adaptive_size(model, context)
    bit = 1 if decode_target(state, ADAPTIVE_BITS) >= zero else 0
    if bit:
        decode_advance(data, end, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        decode_advance(data, end, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)
    return bit


@njit(error_model="numpy", forceinline=True)
@no_type_check
def normal_cdf(boundary, mean, inverse, table):
    """Distribution function, out of 2**24, at `boundary` (both in steps with MEAN_BITS fractional bits)."""
    z = ((boundary - mean) * inverse) >> Z_SHIFT
    if z <= -Z_CLIP:
        return ZERO
    if z >= Z_CLIP:
        return TOTAL
    z += Z_CLIP
    cell = z >> Z_CELL_BITS
    base = table[cell]
    return base + (((table[cell + 1] - base) * (z & Z_FRACTION)) >> Z_CELL_BITS)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def cumulative(symbol, low, high, mean0, inverse0, mean1, inverse1, weight, table):
    """Start of the interval of `symbol` in `[low, high + 1]`: mixture CDF below it, and one unit for each symbol."""
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


@njit(error_model="numpy", forceinline=True)
@no_type_check
def window(mean0, scale0, mean1, scale1, weight, widths):
    """First and last symbol that have an interval of their own."""
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


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_escape(buffer, state, excess):
    """Codes a distance >= 0 beyond the window: Elias gamma of `excess + 1`, at most 32 bits."""
    value = excess + 1
    length = 0
    while value >> (length + 1):
        length += 1
    for _ in range(length):
        encode_raw(buffer, state, ONE)
    encode_raw(buffer, state, ZERO)
    for i in range(length - 1, -1, -1):
        encode_raw(buffer, state, (value >> i) & 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_escape(data, end, state):
    """Inverse of `encode_escape`; hostile codes stop at 32 bits."""
    length = 0
    while length < 32 and decode_raw(data, end, state):
        length += 1
    value = 1
    for _ in range(length):
        value = (value << 1) | decode_raw(data, end, state)
    return value - 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_symbol(buffer, state, symbol, mean0, scale0, mean1, scale1, weight, inverses, widths, table):
    """Codes an integer under a normal (weight 65536) or a mixture of two."""
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


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_symbol(data, end, state, mean0, scale0, mean1, scale1, weight, inverses, widths, table):
    """Inverse of `encode_symbol`: brackets the symbol outwards from the heavier mean, then bisects."""
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
