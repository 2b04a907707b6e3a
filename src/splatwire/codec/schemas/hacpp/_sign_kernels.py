"""Numba kernels that code the signs of the hash-grid rows that some anchor reads."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

STATES = 32
"""Contexts for each level and feature: up to three features before it in the row, and its value in the row before."""


@njit(borrows=True)
@no_type_check
def sign_context(level, feature, depth, signs, row, previous):
    """Context of one sign: its level and feature, the row's signs so far, the same feature of the last row coded."""
    context = (level * depth + feature) * STATES
    for back in range(1, min(feature, 3) + 1):
        if signs[row, feature - back] > 0:
            context += 1 << (back - 1)
    if previous >= 0:
        context += 8 if signs[previous, feature] > 0 else 16
    return context


@njit(nogil=True)
@no_type_check
def encode_signs(signs, touched, level_of, models, buffer):
    """Codes the signs of all touched rows; returns the number of bytes."""
    state = np.empty(3, np.int64)
    encoder_start(state)
    previous, depth = np.int64(-1), signs.shape[1]
    for row in range(len(touched)):
        if touched[row]:
            for feature in range(depth):
                context = sign_context(level_of[row], feature, depth, signs, row, previous)
                encode_bit(buffer, state, models, context, 1 if signs[row, feature] > 0 else 0)
            previous = row
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_signs(data, touched, level_of, models, signs):
    """Inverse of `encode_signs`; rows that are not touched become +1."""
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    previous, depth = np.int64(-1), signs.shape[1]
    for row in range(len(touched)):
        for feature in range(depth):
            signs[row, feature] = 1
        if touched[row]:
            for feature in range(depth):
                context = sign_context(level_of[row], feature, depth, signs, row, previous)
                signs[row, feature] = 2 * decode_bit(data, len(data), state, models, context) - 1
            previous = row
