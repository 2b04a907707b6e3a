"""Numba kernels that code one array as one stream."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import decode_symbol, encode_symbol
from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit


@njit(nogil=True)
@no_type_check
def encode_symbols(symbols, mean0, scale0, mean1, scale1, weight, inverses, widths, table, buffer):
    """Codes symbols under mixtures of two normals; returns the number of bytes."""
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
    """Inverse of `encode_symbols`."""
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    for i in range(len(symbols)):
        symbols[i] = decode_symbol(
            data, len(data), state, mean0[i], scale0[i], mean1[i], scale1[i], weight[i], inverses, widths, table
        )


@njit(nogil=True)
@no_type_check
def encode_bits(bits, contexts, model, buffer):
    """Codes bits with one adaptive model per context; returns the number of bytes."""
    state = np.empty(3, np.int64)
    encoder_start(state)
    for i in range(len(bits)):
        encode_bit(buffer, state, model, contexts[i], np.int64(bits[i]))
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_bits(data, contexts, model, bits):
    """Inverse of `encode_bits`."""
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    for i in range(len(bits)):
        bits[i] = decode_bit(data, len(data), state, model, contexts[i])
