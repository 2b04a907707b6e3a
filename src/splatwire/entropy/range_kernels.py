"""Numba kernels of the range coder.

The state of an encoder or a decoder is an int64 array of three numbers, changed in place.
"""
# `tests/reference/range_coder.py` is the same in plain Python.
# State: encoder `[low, range, position]`, decoder `[code, range, position]`. Numbers stay below 2**49, so signed 64-bit
# arithmetic never overflows.
# numba compiles a function once per combination of argument types, and a literal number is a separate type. All calls
# therefore pass int64: values from narrower arrays are converted, and constants are numpy scalars.

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
    """Encodes a symbol with a range encoder.

    Args:
        buffer: Output bytes.
        state: State of the range encoder, changed in place.
        start: Start of the symbol's probability interval, in units of `2**-total_bits`.
        size: Size of this interval, at least 1.
        total_bits: Number of bits of a probability.
    """
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
    """Initialises the state of a range encoder, int64 (3)."""
    state[0] = 0
    state[1] = 1 << TOP
    state[2] = 0


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def encoder_finish(buffer, state):
    """Writes the last bytes of a range encoder's output to `buffer`; returns the size of the output in bytes."""
    # Zeros at the end are omitted, because decoders read zeros there.
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
    """Initialises the state, int64 (3), of a range decoder that reads `data[begin:end]`."""
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
    """Returns the position of the next symbol on the probability axis, in units of `2**-total_bits`.

    The next symbol is the one whose probability interval contains this position.
    """
    # The division leaves a remainder of the range behind the last interval. Malformed bytes may point there.
    # The quotient of numbers below 2**53, rounded down, is exact in float64, and faster than one of integers.
    return min(np.int64(np.float64(state[0]) / np.float64(state[1] >> total_bits)), (1 << total_bits) - 1)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_advance(data, end, state, start, size, total_bits):
    """Moves a decoder past a symbol with the probability interval `[start, start + size)`.

    Args:
        data: Input bytes.
        end: End of the code in `data`.
        state: State of the decoder, changed in place.
        start: Start of the interval, in units of `2**-total_bits`.
        size: Size of the interval, at least 1.
        total_bits: Number of bits of a probability.
    """
    # With an empty interval the loop would never end. Zeros are read beyond the end of the data.
    unit = state[1] >> total_bits
    span = unit * size
    code = min(state[0] - unit * start, span - 1)  # As in `decode_target`: keeps malformed codes within their range
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
    """Encodes a bit with equal probabilities for 0 and 1."""
    encode_interval(buffer, state, bit, ONE, ONE)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_raw(data, end, state):
    """Decodes a bit with equal probabilities for 0 and 1."""
    bit = ONE if state[0] >= state[1] >> ONE else ZERO
    decode_advance(data, end, state, bit, ONE, ONE)
    return bit


@njit(borrows=True, error_model="numpy")
@no_type_check
def encode_bits(buffer, state, value, bits):
    """Encodes the low `bits` bits (at most 63) of a number. Each bit is 0 or 1 with equal probability."""
    while bits > 0:
        part_bits = min(bits, RAW_BITS)
        bits -= part_bits
        encode_interval(buffer, state, (value >> bits) & ((ONE << part_bits) - ONE), ONE, part_bits)


@njit(borrows=True, error_model="numpy")
@no_type_check
def decode_bits(data, end, state, bits):
    """Decodes a number of `bits` bits written by `encode_bits`."""
    value = np.int64(0)
    while bits > 0:
        part_bits = min(bits, RAW_BITS)
        bits -= part_bits
        part = decode_target(state, part_bits)
        decode_advance(data, end, state, part, ONE, part_bits)
        value = (value << part_bits) | part
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def encode_below(buffer, state, value, count):
    """Encodes a number from 0 to `count - 1` with equal probabilities; `count` is at most 2**16."""
    start = (value << RAW_BITS) // count
    encode_interval(buffer, state, start, ((value + ONE) << RAW_BITS) // count - start, RAW_BITS)


@njit(borrows=True, error_model="numpy")
@no_type_check
def decode_below(data, end, state, count):
    """Decodes a number from 0 to `count - 1` written by `encode_below`."""
    value = ((decode_target(state, RAW_BITS) + ONE) * count - ONE) >> RAW_BITS
    start = (value << RAW_BITS) // count
    decode_advance(data, end, state, start, ((value + ONE) << RAW_BITS) // count - start, RAW_BITS)
    return value


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def adaptive_update(model, context, bit):
    """Adapts the probability estimates of a context, in place, after the bit `bit` was coded."""
    # A model has two estimates of P(bit = 0): one adapts slowly, one fast.
    for column, rate in ((0, ADAPTIVE_SLOW), (1, ADAPTIVE_FAST)):
        p = model[context, column]
        model[context, column] = p - (p >> rate) if bit else p + ((65536 - p) >> rate)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def zero_probability(model, context):
    """Returns the probability that the next bit of a context is 0, in units of 2**-16, from 32 to 65504."""
    # Mean of the two estimates of the model, and size of the range coder's interval for the bit 0.
    p = (model[context, 0] + model[context, 1]) >> 1
    return min(max(p, 32), 65536 - 32)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def encode_bit(buffer, state, model, context, bit):
    """Encodes a bit with the adaptive model of a context, and updates the model."""
    zero = zero_probability(model, context)
    if bit:
        encode_interval(buffer, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        encode_interval(buffer, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def decode_bit(data, end, state, model, context):
    """Decodes a bit with the adaptive model of a context, and updates the model."""
    zero = zero_probability(model, context)
    # Equivalent to `decode_target(...) >= zero`, without its division.
    bit = 1 if state[0] >= zero * (state[1] >> ADAPTIVE_BITS) else 0
    if bit:
        decode_advance(data, end, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        decode_advance(data, end, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(model, context, bit)
    return bit
