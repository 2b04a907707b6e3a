"""Numba kernels that code the sketch (coarse copies of anchors) with an adaptive binary range coder."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import decode_escape, encode_escape
from splatwire.entropy.range_kernels import decode_bit, decode_raw, encode_bit, encode_raw
from splatwire.ops.compiled import njit

OWN = 4
"""Largest magnitude with separate probability models per basis vector and level; larger magnitudes share models per
level."""
UNARY = 14
"""Largest magnitude coded in unary; larger magnitudes are coded as an escape."""
SHARED = UNARY - OWN
HISTORY = 4
"""Number of contexts of the bit "anchor has a copy": the number of anchors with a copy among the previous four, at most
3."""
BYTES_PER_VALUE = 40
"""Maximum bytes of a coded value: 15 adaptive bits of at most 11 bits, a sign and an escape of 65 bits."""
BYTES_PER_BIT = 2


@njit(error_model="numpy")
@no_type_check
def history_of(levels, n):
    """Returns a context of the entropy coder for anchor `n`: how many of the four anchors before it have a copy.

    Args:
        levels: Precision level of each anchor's copy; 0 for anchors without a copy.
        n: Index of the anchor.

    Returns:
        0 to 3; four copied anchors count as 3.
    """
    count = 0
    for i in range(max(n - 4, 0), n):
        if levels[i] > 0:
            count += 1
    return min(count, HISTORY - 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_value(buffer, state, model, own, shared, value):
    """Encodes a signed integer: a bit that is 1 unless the integer is 0, the sign, and the magnitude.

    The magnitude is coded in unary, or in Elias gamma code if it is large. The first bit and the first `OWN` bits of
    the magnitude have separate probabilities for each column of coefficients. Further bits have probabilities that all
    columns of a precision level share.

    Args:
        buffer: Output bytes.
        state: State of the range encoder.
        model: Table of adaptive bit probabilities.
        own: Index in `model` of the column's first probability.
        shared: Index in `model` of the level's first shared probability.
        value: The integer.
    """
    encode_bit(buffer, state, model, own, 1 if value != 0 else 0)
    if value == 0:
        return
    encode_raw(buffer, state, 1 if value < 0 else 0)
    size = abs(value) - 1
    for i in range(UNARY):
        more = 1 if size > i else 0
        encode_bit(buffer, state, model, own + 1 + i if i < OWN else shared + i - OWN, more)
        if not more:
            return
    encode_escape(buffer, state, size - UNARY)


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_value(data, state, model, own, shared):
    """Decodes a signed integer written by `encode_value`.

    Args:
        data: Input bytes.
        state: State of the range decoder, changed in place.
        model: Table of adaptive bit probabilities, changed in place.
        own: Index in `model` of the column's first probability.
        shared: Index in `model` of the first probability that all columns of the precision level share.

    Returns:
        The integer, int64.
    """
    end = len(data)
    if not decode_bit(data, end, state, model, own):
        return np.int64(0)
    negative = decode_raw(data, end, state)
    size = np.int64(UNARY)
    for i in range(UNARY):
        if not decode_bit(data, end, state, model, own + 1 + i if i < OWN else shared + i - OWN):
            size = np.int64(i)
            break
    if size == UNARY:
        size += decode_escape(data, end, state)
    return -size - 1 if negative else size + 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_levels(buffer, state, model, levels, buckets, num_levels):
    """Encodes the precision level of each anchor's copy, in unary; level 0 means that an anchor has no copy.

    Args:
        buffer: Output bytes.
        state: State of the range encoder.
        model: Table of adaptive bit probabilities.
        levels: Precision level of each anchor's copy; 0 without a copy.
        buckets: Size class of each anchor, part of the context.
        num_levels: Number of precision levels.
    """
    first_unary = len(model) - num_levels
    for n in range(len(levels)):
        context = buckets[n] * HISTORY + history_of(levels, n)
        encode_bit(buffer, state, model, context, 1 if levels[n] > 0 else 0)
        for i in range(1, num_levels):
            if levels[n] < i:
                break
            encode_bit(buffer, state, model, first_unary + i, 1 if levels[n] > i else 0)


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_levels(data, state, model, buckets, num_levels, levels):
    """Decodes the precision levels of copies, written by `encode_levels`.

    Args:
        data: Input bytes.
        state: State of the range decoder, changed in place.
        model: Table of adaptive bit probabilities, changed in place.
        buckets: Size class of each anchor, part of the context.
        num_levels: Number of precision levels.
        levels: Output: precision level of each anchor's copy; 0 without a copy.

    Returns:
        Number of anchors that have a copy.
    """
    first_unary = len(model) - num_levels
    count = 0
    for n in range(len(levels)):
        levels[n] = 0
        if decode_bit(data, len(data), state, model, buckets[n] * HISTORY + history_of(levels, n)):
            level = 1
            while level < num_levels and decode_bit(data, len(data), state, model, first_unary + level):
                level += 1
            levels[n] = level
            count += 1
    return count


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_rows(buffer, state, bit_model, model, levels, masks, values, offsets):
    """Encodes the offset mask, the transform coefficients and the existing offsets of each copied anchor.

    Args:
        buffer: Output bytes.
        state: State of the range encoder.
        bit_model: Adaptive probabilities of mask bits.
        model: Adaptive probabilities of coefficients and offsets.
        levels: Precision level of each of the M copies, from 1.
        masks: Offset masks, uint8 (M, K).
        values: Quantised transform coefficients, int64 (M, C).
        offsets: Quantised offsets, int64 (M, 3 K); only those of existing offsets are coded.
    """
    columns, axes = values.shape[1], 3
    per_level = (columns + axes) * (1 + OWN) + SHARED
    for n in range(len(levels)):
        first = (levels[n] - 1) * per_level
        shared, ones = first + (columns + axes) * (1 + OWN), 0
        for k in range(masks.shape[1]):
            bit = np.int64(masks[n, k])
            encode_bit(buffer, state, bit_model, k * HISTORY + min(ones, HISTORY - 1), bit)
            ones += bit
        for c in range(columns):
            encode_value(buffer, state, model, first + c * (1 + OWN), shared, values[n, c])
        for k in range(masks.shape[1]):
            if masks[n, k]:
                for axis in range(axes):
                    own = first + (columns + axis) * (1 + OWN)
                    encode_value(buffer, state, model, own, shared, offsets[n, 3 * k + axis])


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_rows(data, state, bit_model, model, levels, masks, values, offsets):
    """Decodes the copies of anchors, written by `encode_rows`.

    Args:
        data: Input bytes.
        state: State of the range decoder, changed in place.
        bit_model: Adaptive probabilities of mask bits, changed in place.
        model: Adaptive probabilities of coefficients and offsets, changed in place.
        levels: Precision level of each of the M copies, from 1.
        masks: Output: offset masks, uint8 (M, K).
        values: Output: quantised transform coefficients, int64 (M, C).
        offsets: Output: quantised offsets, int64 (M, 3 K); 0 for offsets that do not exist.
    """
    columns, axes = values.shape[1], 3
    per_level = (columns + axes) * (1 + OWN) + SHARED
    for n in range(len(levels)):
        first = (levels[n] - 1) * per_level
        shared, ones = first + (columns + axes) * (1 + OWN), 0
        for k in range(masks.shape[1]):
            bit = decode_bit(data, len(data), state, bit_model, k * HISTORY + min(ones, HISTORY - 1))
            masks[n, k] = bit
            ones += bit
        for c in range(columns):
            values[n, c] = decode_value(data, state, model, first + c * (1 + OWN), shared)
        for k in range(masks.shape[1]):
            for axis in range(axes):
                offsets[n, 3 * k + axis] = 0
                if masks[n, k]:
                    own = first + (columns + axis) * (1 + OWN)
                    offsets[n, 3 * k + axis] = decode_value(data, state, model, own, shared)
