"""Numba kernels of a range coder that reads or writes several bytes at once."""
# The decoder reads the array from `words_of`. The coder of `range_kernels` reads and writes byte by byte and is the
# plain reference: both read and write the same bytes. No kernel branches on the number of bytes of a symbol, because
# processors predict such branches badly.

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import (
    ADAPTIVE_BITS,
    BOTTOM,
    ONE,
    RAW_BITS,
    TOP,
    ZERO,
    adaptive_update,
    zero_probability,
)
from splatwire.entropy.range_kernels import decode_target as target_of
from splatwire.ops.compiled import njit

WORD_BITS = 56
"""Bits of a word: seven bytes, so that words are not negative as int64."""


@njit(error_model="numpy")
@no_type_check
def words_of(data):
    """Converts a packet to overlapping integers of seven bytes, for a decoder that reads several bytes at once.

    Integer i consists of the bytes i to i + 6, the first one as its highest byte.

    Args:
        data: Bytes of the packet, uint8 (n).

    Returns:
        int64 (n + 1).
    """
    words = np.empty(len(data) + 1, np.int64)
    word = np.int64(0)
    words[len(data)] = word
    for i in range(len(data) - 1, -1, -1):
        word = (word >> 8) | (np.int64(data[i]) << (WORD_BITS - 8))
        words[i] = word
    return words


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def advance(words, state, start, size, total_bits):
    """Moves a decoder past a symbol with the probability interval `[start, start + size)`.

    `start` and `size` are in units of `2**-total_bits`.
    """
    # `total_bits` is at most 24, so that a symbol consumes at most three bytes.
    unit = state[1] >> total_bits
    span = unit * size
    code = min(state[0] - unit * start, span - 1)
    count = np.int64(span < BOTTOM) + np.int64(span < BOTTOM >> 8) + np.int64(span < BOTTOM >> 16)
    bits, position = count << 3, state[2]
    state[0] = (code << bits) | (words[min(position, len(words) - 1)] >> (WORD_BITS - bits))
    state[1] = span << bits
    state[2] = position + count


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def raw_bit(words, state):
    """Decodes one bit, 0 or 1 with equal probabilities, and advances the decoder's state."""
    bit = ONE if state[0] >= state[1] >> ONE else ZERO
    advance(words, state, bit, ONE, ONE)
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def adaptive_bit(words, state, models, context):
    """Decodes a bit with the adaptive model of a context, and updates the model."""
    zero = zero_probability(models, context)
    bit = ONE if state[0] >= zero * (state[1] >> ADAPTIVE_BITS) else ZERO
    if bit:
        advance(words, state, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        advance(words, state, ZERO, zero, ADAPTIVE_BITS)
    adaptive_update(models, context, bit)
    return bit


@njit(borrows=True, error_model="numpy")
@no_type_check
def raw_bits(words, state, bits):
    """Decodes a number of `bits` bits with equal probabilities."""
    value = np.int64(0)
    while bits > 0:
        part_bits = min(bits, RAW_BITS)
        bits -= part_bits
        part = target_of(state, part_bits)
        advance(words, state, part, ONE, part_bits)
        value = (value << part_bits) | part
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def number_below(words, state, count):
    """Decodes a number from 0 to `count - 1` with equal probabilities."""
    value = ((target_of(state, RAW_BITS) + ONE) * count - ONE) >> RAW_BITS
    # Quotients of numbers below 2**53 are exact in float64 when rounded down, and faster than those of integers.
    size = np.float64(count)
    start = np.int64(np.float64(value << RAW_BITS) / size)
    after = np.int64(np.float64((value + ONE) << RAW_BITS) / size)
    advance(words, state, start, after - start, RAW_BITS)
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def escaped(words, state):
    """Decodes a non-negative integer in Elias gamma code, written by `normal_kernels.encode_escape`."""
    length = 0
    while length < 32 and raw_bit(words, state):
        length += 1
    value = 1
    for _ in range(length):
        value = (value << 1) | raw_bit(words, state)
    return value - 1


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def write_interval(buffer, state, start, size, total_bits):
    """Encodes a symbol, given its probability interval `[start, start + size)` in units of `2**-total_bits`.

    Up to three bytes beyond the encoded ones are overwritten.
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
    # A symbol has at most 24 bits, so that it completes at most three bytes.
    count = np.int64(span < BOTTOM) + np.int64(span < BOTTOM >> 8) + np.int64(span < BOTTOM >> 16)
    buffer[position] = low >> 40
    buffer[position + 1] = low >> 32
    buffer[position + 2] = low >> 24
    bits = count << 3
    state[0] = (low << bits) & ((1 << TOP) - 1)
    state[1] = span << bits
    state[2] = position + count


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def write_bit(buffer, state, models, context, bit):
    """Encodes a bit with the adaptive model of a context, and updates the model."""
    zero = zero_probability(models, context)
    write_interval(buffer, state, zero if bit else ZERO, 65536 - zero if bit else zero, ADAPTIVE_BITS)
    adaptive_update(models, context, bit)


@njit(borrows=True, error_model="numpy")
@no_type_check
def write_raw(buffer, state, value, bits):
    """Encodes the low `bits` bits (at most 63) of a number with equal probabilities."""
    while bits > 0:
        part_bits = min(bits, RAW_BITS)
        bits -= part_bits
        write_interval(buffer, state, (value >> bits) & ((ONE << part_bits) - ONE), ONE, part_bits)


@njit(borrows=True, error_model="numpy")
@no_type_check
def write_below(buffer, state, value, count):
    """Encodes a number from 0 to `count - 1` with equal probabilities; `count` is at most 2**16."""
    # Quotients of numbers below 2**53 are exact in float64 when rounded down, and faster than those of integers.
    size = np.float64(count)
    start = np.int64(np.float64(value << RAW_BITS) / size)
    after = np.int64(np.float64((value + ONE) << RAW_BITS) / size)
    write_interval(buffer, state, start, after - start, RAW_BITS)
