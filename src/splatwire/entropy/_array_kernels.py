"""Numba kernels that code a whole array of integers or bits as one range coder stream."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import decode_symbol, encode_symbol
from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit


@njit(nogil=True)
@no_type_check
def encode_symbols(symbols, mean0, scale0, mean1, scale1, weight, inverses, widths, table, buffer):
    """Encodes integers, each under its own normal distribution or mixture of two.

    Args:
        symbols: The integers.
        mean0: Mean of the first component of each distribution, see `entropy.coder.Mixtures`.
        scale0: Standard deviation of the first component.
        mean1: Mean of the second component.
        scale1: Standard deviation of the second component.
        weight: Weight of the first component.
        inverses: Reciprocals of the standard deviations, by scale index.
        widths: Largest distance from the mean that needs no escape code, by scale index.
        table: Standard normal CDF, from `normal_table`.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    state = np.empty(3, np.int64)
    encoder_start(state)
    for i in range(len(symbols)):
        encode_symbol(
            buffer, state, symbols[i], mean0[i], scale0[i], mean1[i], scale1[i], weight[i], inverses, widths, table
        )
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_symbols(data, mean0, scale0, mean1, scale1, weight, inverses, widths, table, symbols):
    """Decodes integers written by `encode_symbols`, and writes them to `symbols`.

    Means, standard deviations, weights and tables must be those that were passed to `encode_symbols`.
    """
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    for i in range(len(symbols)):
        symbols[i] = decode_symbol(
            data, len(data), state, mean0[i], scale0[i], mean1[i], scale1[i], weight[i], inverses, widths, table
        )


@njit(nogil=True)
@no_type_check
def encode_bits(bits, contexts, model, buffer):
    """Encodes bits with adaptive probability models.

    Args:
        bits: The bits, 0 or 1.
        contexts: Index of the model of each bit.
        model: State of all models, changed in place.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    state = np.empty(3, np.int64)
    encoder_start(state)
    for i in range(len(bits)):
        encode_bit(buffer, state, model, contexts[i], np.int64(bits[i]))
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_bits(data, contexts, model, bits):
    """Decodes bits written by `encode_bits`.

    Args:
        data: Input bytes.
        contexts: Index of the model of each bit.
        model: State of all models, changed in place.
        bits: Output: the bits.
    """
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    for i in range(len(bits)):
        bits[i] = decode_bit(data, len(data), state, model, contexts[i])
