"""Numba kernels that code the sketch: everything in one run of the range coder, adaptive bits only."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import decode_escape, encode_escape
from splatwire.entropy.range_kernels import decode_bit, decode_raw, encode_bit, encode_raw
from splatwire.ops.compiled import njit

OWN = 4
"""Magnitudes 1 to 4 have models of their own for each column and level; larger ones share those of the level."""
UNARY = 14
"""Magnitudes above are escaped."""
SHARED = UNARY - OWN
HISTORY = 4
"""How often each model of the level's first bit is there: by how many of the anchors just before were sketched."""
BYTES_PER_VALUE = 40
"""Room for the costliest value: 15 adaptive bits of 11 bits at most, a sign and an escape of 65."""
BYTES_PER_BIT = 2


@njit(error_model="numpy")
@no_type_check
def history_of(levels, n):
    """How many of the four anchors before anchor `n` are sketched, at most 3."""
    count = 0
    for i in range(max(n - 4, 0), n):
        if levels[i] > 0:
            count += 1
    return min(count, HISTORY - 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_value(buffer, state, model, own, shared, value):
    """Codes an integer: zero or not, sign, magnitude in unary, escape."""
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
    """Inverse of `encode_value`."""
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
    """Codes the level of every anchor, 0 for none: a bit, then unary."""
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
    """Inverse of `encode_levels`; returns how many anchors have a level."""
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
    """Codes what is known of each sketched anchor: masks, columns, offsets that exist."""
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
    """Inverse of `encode_rows`."""
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
