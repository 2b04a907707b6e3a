"""Numba kernels that code the sketch (coarse copies of anchors) with an adaptive binary range coder.

Depending on its `Coder`, a kernel encodes or decodes values.
"""

from typing import Any, NamedTuple, no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import decode_escape, encode_escape
from splatwire.entropy.range_kernels import (
    decode_bit,
    decode_raw,
    decoder_start,
    encode_bit,
    encode_raw,
    encoder_finish,
    encoder_start,
)
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


class Coder(NamedTuple):
    """Range coder of a sketch (coarse copies of a scene's most important anchors), in either direction.

    Attributes:
        decoding: True when decoding, False when encoding.
        data: Bytes to decode, or the output buffer, uint8.
        state: State of the range coder, int64 (3).
    """

    decoding: Any
    data: Any
    state: Any

    @staticmethod
    def encoder(num_bytes: int) -> "Coder":
        """Returns an encoder whose output has at most `num_bytes` bytes."""
        state = np.empty(3, dtype=np.int64)
        encoder_start(state)
        return Coder(False, np.empty(num_bytes, dtype=np.uint8), state)

    @staticmethod
    def decoder(coded: bytes) -> "Coder":
        """Returns a coder that decodes bytes."""
        data, state = np.frombuffer(bytearray(coded), dtype=np.uint8), np.empty(3, dtype=np.int64)
        decoder_start(data, 0, len(data), state)
        return Coder(True, data, state)

    def finish(self) -> bytes:
        """Ends the encoding, and returns all encoded bytes."""
        return self.data[: encoder_finish(self.data, self.state)].tobytes()


@njit(error_model="numpy")
@no_type_check
def copy_flag_context(precision_levels, n):
    """Returns the context for the bit that is 1 if anchor `n` has a copy.

    The context is the number of anchors with a copy among the four anchors before `n`, at most 3.

    Args:
        precision_levels: Precision level of each anchor's copy; 0 for anchors without a copy.
        n: Index of the anchor.
    """
    count = 0
    for i in range(max(n - 4, 0), n):
        if precision_levels[i] > 0:
            count += 1
    return min(count, HISTORY - 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def code_bit(coder, models, context, bit):
    """Encodes or decodes a bit with the adaptive model of a context; returns the bit. A decoder ignores `bit`."""
    if coder.decoding:
        return decode_bit(coder.data, len(coder.data), coder.state, models, context)
    encode_bit(coder.data, coder.state, models, context, bit)
    return bit


@njit(nogil=True, error_model="numpy")
@no_type_check
def code_value(coder, models, column_start, shared_start, value):
    """Encodes or decodes a signed integer: first a bit that is 0 only for the integer 0, then sign and magnitude.

    Args:
        coder: State of the range coder.
        models: Table of adaptive bit probabilities, changed in place.
        column_start: Index in `models` of the probabilities for this type of value, such as the first transform
            coefficient.
        shared_start: Index in `models` of the probabilities for all values of a precision level.
        value: The integer; ignored by a decoder.

    Returns:
        The integer.
    """
    if not code_bit(coder, models, column_start, np.int64(value != 0)):
        return np.int64(0)
    data, state, negative, size = coder.data, coder.state, np.int64(value < 0), np.int64(abs(value) - 1)
    if coder.decoding:
        negative = decode_raw(data, len(data), state)
    else:
        encode_raw(data, state, negative)
    for i in range(UNARY):
        if not code_bit(coder, models, column_start + 1 + i if i < OWN else shared_start + i - OWN, np.int64(size > i)):
            return -i - 1 if negative else i + 1
    if coder.decoding:
        size = UNARY + decode_escape(data, len(data), state)
    else:
        encode_escape(data, state, size - UNARY)
    return -size - 1 if negative else size + 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def code_levels(coder, models, precision_levels, buckets, num_levels):
    """Encodes or decodes which anchors have a coarse copy, and the precision level of each copy.

    Args:
        coder: State of the range coder.
        models: Table of adaptive bit probabilities, changed in place.
        precision_levels: Precision level of each anchor's copy, from 1; 0 without a copy. Input of an encoder, output
            of a decoder.
        buckets: Size class of each anchor; selects the context.
        num_levels: Number of precision levels.

    Returns:
        Number of anchors that have a copy.
    """
    first_unary = len(models) - num_levels
    count = 0
    for n in range(len(precision_levels)):
        context = buckets[n] * HISTORY + copy_flag_context(precision_levels, n)
        wanted, level = precision_levels[n], 0
        if code_bit(coder, models, context, np.int64(wanted > 0)):
            level, count = 1, count + 1
            while level < num_levels and code_bit(coder, models, first_unary + level, np.int64(wanted > level)):
                level += 1
        precision_levels[n] = level
    return count


@njit(nogil=True, error_model="numpy")
@no_type_check
def code_rows(coder, bit_models, models, precision_levels, masks, values, offsets):
    """Encodes or decodes the content of coarse copies: offset masks, transform coefficients and offsets.

    The arrays `masks`, `values` and `offsets` are the input of an encoder, or the output of a decoder.

    Args:
        coder: State of the range coder.
        bit_models: Adaptive probabilities of mask bits, changed in place.
        models: Adaptive probabilities of coefficients and offsets, changed in place.
        precision_levels: Precision level of each of the M copies, from 1.
        masks: Offset masks, uint8 (M, K).
        values: Quantised transform coefficients, int64 (M, C).
        offsets: Quantised offsets, int64 (M, 3 K); 0 for offsets that do not exist.
    """
    columns, axes = values.shape[1], 3
    per_level = (columns + axes) * (1 + OWN) + SHARED
    for n in range(len(precision_levels)):
        first = (precision_levels[n] - 1) * per_level
        shared, ones = first + (columns + axes) * (1 + OWN), 0
        for k in range(masks.shape[1]):
            masks[n, k] = code_bit(coder, bit_models, k * HISTORY + min(ones, HISTORY - 1), np.int64(masks[n, k]))
            ones += masks[n, k]
        for c in range(columns):
            values[n, c] = code_value(coder, models, first + c * (1 + OWN), shared, values[n, c])
        for k in range(masks.shape[1]):
            for axis in range(axes):
                column, context = 3 * k + axis, first + (columns + axis) * (1 + OWN)
                offsets[n, column] = (
                    code_value(coder, models, context, shared, offsets[n, column]) if masks[n, k] else 0
                )
