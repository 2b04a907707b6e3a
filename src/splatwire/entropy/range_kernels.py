"""Numba kernels of the range coder; `tests/reference/range_coder.py` says the same in plain Python.

State of one coder is an int64 row: encoder `[low, range, position]`, decoder `[code, range, position]`. Numbers stay
below 2**49, so signed 64-bit arithmetic never overflows.

numba compiles a function anew for each combination of types that it is called with, and takes a literal number for a
type of its own. So these are called with int64 throughout: what comes out of narrower arrays is converted, and
constants are numpy's.
"""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

TOP = 48
BOTTOM = 1 << 40
LOW_MASK = (1 << 40) - 1

ADAPTIVE_BITS, RAW_BITS = np.int64(16), np.int64(16)
ZERO, ONE = np.int64(0), np.int64(1)

ADAPTIVE_SLOW = 7
ADAPTIVE_FAST = 4


@njit(borrows=True, error_model="numpy", forceinline=True)
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


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def encoder_start(state):
    """Puts a fresh encoder into `state`."""
    state[0] = 0
    state[1] = 1 << TOP
    state[2] = 0


@njit(borrows=True, nogil=True, error_model="numpy")
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


@njit(borrows=True, nogil=True, error_model="numpy")
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


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_target(state, total_bits):
    """Number in `[0, 2**total_bits)` that the code points at."""
    # Bytes that no encoder wrote may point behind the last interval, at what the division leaves of the span.
    return min(state[0] // (state[1] >> total_bits), (1 << total_bits) - 1)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_advance(data, end, state, start, size, total_bits):
    """Removes `[start, start + size)` from the code and reads what is needed next; past `end` zeros are read.

    `size` is at least 1: an empty interval has no end.
    """
    unit = state[1] >> total_bits
    span = unit * size
    code = min(state[0] - unit * start, span - 1)  # see `decode_target`: the code stays within its span
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


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def encode_raw(buffer, state, bit):
    """Writes a bit that is as likely one as zero."""
    encode_interval(buffer, state, bit, ONE, ONE)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_raw(data, end, state):
    """Reads a bit that is as likely one as zero."""
    bit = ONE if state[0] >= state[1] >> ONE else ZERO
    decode_advance(data, end, state, bit, ONE, ONE)
    return bit


@njit(borrows=True, error_model="numpy")
@no_type_check
def encode_bits(buffer, state, value, bits):
    """Writes up to 63 equiprobable bits of a number, the high ones first."""
    while bits > 0:
        some = min(bits, RAW_BITS)
        bits -= some
        encode_interval(buffer, state, (value >> bits) & ((ONE << some) - ONE), ONE, some)


@njit(borrows=True, error_model="numpy")
@no_type_check
def decode_bits(data, end, state, bits):
    """Reads what `encode_bits` wrote."""
    value = np.int64(0)
    while bits > 0:
        some = min(bits, RAW_BITS)
        bits -= some
        part = decode_target(state, some)
        decode_advance(data, end, state, part, ONE, some)
        value = (value << some) | part
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def encode_below(buffer, state, value, count):
    """Writes a number below `count`, at most 2**16, all alike probable."""
    start = (value << RAW_BITS) // count
    encode_interval(buffer, state, start, ((value + ONE) << RAW_BITS) // count - start, RAW_BITS)


@njit(borrows=True, error_model="numpy")
@no_type_check
def decode_below(data, end, state, count):
    """Reads what `encode_below` wrote."""
    value = ((decode_target(state, RAW_BITS) + ONE) * count - ONE) >> RAW_BITS
    start = (value << RAW_BITS) // count
    decode_advance(data, end, state, start, ((value + ONE) << RAW_BITS) // count - start, RAW_BITS)
    return value


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def adaptive_update(model, context, bit):
    """Moves a model's two estimates of P(bit = 0), in units of 2**-16, one fast and one slow."""
    for column, rate in ((0, ADAPTIVE_SLOW), (1, ADAPTIVE_FAST)):
        p = model[context, column]
        model[context, column] = p - (p >> rate) if bit else p + ((65536 - p) >> rate)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def adaptive_size(model, context):
    """Size of the interval of a zero bit out of 2**16: the mean of the two estimates, kept off the ends."""
    p = (model[context, 0] + model[context, 1]) >> 1
    return min(max(p, 32), 65536 - 32)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def encode_bit(buffer, state, model, context, bit):
    """Codes one bit with an adaptive model and updates it."""
    zero = adaptive_size(model, context)
    if bit:
        encode_interval(buffer, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        encode_interval(buffer, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_bit(data, end, state, model, context):
    """Decodes one bit with an adaptive model and updates it."""
    zero = adaptive_size(model, context)
    # What `decode_target(...) >= zero` says, without its division.
    bit = 1 if state[0] >= zero * (state[1] >> ADAPTIVE_BITS) else 0
    if bit:
        decode_advance(data, end, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        decode_advance(data, end, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)
    return bit
