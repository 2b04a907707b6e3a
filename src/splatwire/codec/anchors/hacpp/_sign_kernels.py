"""Numba kernels that code the signs of the hash grid: all table rows that at least one anchor reads."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

STATES = 32
"""Contexts per level and feature: up to three preceding features of the row, and the same feature of the previous row.
"""


@njit(borrows=True)
@no_type_check
def sign_context(grid_level, feature, features_per_level, signs, row, previous):
    """Returns the index of the adaptive model for a sign in the hash table.

    Args:
        grid_level: Index of the grid level.
        feature: Column of the sign in the table.
        features_per_level: Number of columns, D.
        signs: The hash table, int8 (rows, D).
        row: Table row of the sign.
        previous: Table row that was coded before; -1 for none.
    """
    # The context depends on the grid level, the feature (column of the table), up to three preceding signs of the same
    # row, and the sign of the same feature in the previous coded row.
    context = (grid_level * features_per_level + feature) * STATES
    for back in range(1, min(feature, 3) + 1):
        if signs[row, feature - back] > 0:
            context += 1 << (back - 1)
    if previous >= 0:
        context += 8 if signs[previous, feature] > 0 else 16
    return context


@njit(nogil=True)
@no_type_check
def encode_signs(signs, touched, level_of, models, buffer):
    """Encodes the signs of all hash-table rows that at least one anchor reads.

    Args:
        signs: The hash table, int8 (rows, D), entries -1 or +1.
        touched: Mask of the rows to encode, bool (rows).
        level_of: Grid level of each row.
        models: Adaptive bit models, changed in place.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    state = np.empty(3, np.int64)
    encoder_start(state)
    previous, features_per_level = np.int64(-1), signs.shape[1]
    for row in range(len(touched)):
        if touched[row]:
            for feature in range(features_per_level):
                context = sign_context(level_of[row], feature, features_per_level, signs, row, previous)
                encode_bit(buffer, state, models, context, 1 if signs[row, feature] > 0 else 0)
            previous = row
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_signs(data, touched, level_of, models, signs):
    """Decodes the signs of the hash table, written by `encode_signs`.

    Args:
        data: Input bytes.
        touched: Mask of the encoded rows, bool (rows).
        level_of: Grid level of each row.
        models: Adaptive bit models, changed in place.
        signs: Output: the hash table, int8 (rows, D).
    """
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    previous, features_per_level = np.int64(-1), signs.shape[1]
    for row in range(len(touched)):
        for feature in range(features_per_level):
            signs[row, feature] = 1
        if touched[row]:
            for feature in range(features_per_level):
                context = sign_context(level_of[row], feature, features_per_level, signs, row, previous)
                signs[row, feature] = 2 * decode_bit(data, len(data), state, models, context) - 1
            previous = row
