"""Numba kernels of schema `causal`: numbers between networks and coder, and the symbols of many packets at once.

Arrays of anchors are ordered packet by packet; `starts[p]:starts[p + 1]` are the anchors of packet p. Inside a packet
the order is places, then the stages, each anchor by anchor; the offsets' existence comes before the scale, and only
offsets that exist are coded. `tests/reference/causal_packets.py` is the plain twin.
"""

from typing import no_type_check

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_LIMIT
from splatwire.codec.schemas.causal._place_kernels import encode_place, place_bits
from splatwire.entropy.normal_kernels import ESCAPE, NORMAL, cumulative, decode_symbol, encode_symbol, window
from splatwire.entropy.range_kernels import (
    ONE,
    ZERO,
    decode_advance,
    decode_target,
    decoder_start,
    encode_interval,
    encoder_finish,
    encoder_start,
)
from splatwire.entropy.tables import TOTAL_BITS
from splatwire.ops.compiled import njit

BYTES_PER_SYMBOL = 12
"""Room for the costliest symbol: an escape of 86 bits."""
INPUT_SHIFT = 4
"""From a number with 16 fractional bits to an input with 14, of which a step is a quarter."""
PLACE_SYMBOLS = 3
"""What a place has room for: 29 bytes are the most that it takes."""
LARGEST_SYMBOL = (1 << 14) - (1 << 10)
MASK_BITS = np.int64(16)
MASK_ROOM = np.int64(32)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def activate(numbers, inputs):
    """Turns numbers into inputs of networks."""
    for n in range(numbers.shape[0]):
        for c in range(numbers.shape[1]):
            value = np.int64(numbers[n, c]) >> INPUT_SHIFT
            inputs[n, c] = min(max(value, -ACTIVATION_LIMIT), ACTIVATION_LIMIT)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def scale_indices(spreads, powers, indices):
    """Entries of the scale table: octave, and sixteenths of the fraction's power of two."""
    for n in range(spreads.shape[0]):
        for c in range(spreads.shape[1]):
            spread = np.int64(spreads[n, c]) + (6 << 16)
            fraction = (powers[(spread >> 8) & 255] - (1 << 20)) >> 16
            indices[n, c] = min(max(((spread >> 16) << 4) + fraction, 0), 319)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def add_symbols(symbols, outputs, first, numbers):
    """Numbers of symbols: the predicted mean and whole steps from it."""
    for n in range(numbers.shape[0]):
        for c in range(numbers.shape[1]):
            symbol = min(max(np.int64(symbols[n, c]), -LARGEST_SYMBOL), LARGEST_SYMBOL)
            numbers[n, c] = np.int64(outputs[n, first + c]) + (symbol << 16)


@njit(borrows=True, error_model="numpy")
@no_type_check
def mask_size(weights, logit):
    """How probable it is that an offset exists, out of 2**16."""
    index = min(max(((np.int64(logit) + 2048) >> 12) + 128, 0), 255)
    return min(max(weights[index], MASK_ROOM), (1 << 16) - MASK_ROOM)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _encode_packet(
    begin, end, codes, unknown, chances, masks, logits, symbols, scales, firsts, form, weights, inverses, widths, table,
    out, state,
):  # fmt: skip
    """Codes the anchors [begin, end) into `out`; returns the number of bytes."""
    last = len(firsts) - 2
    encoder_start(state)
    for n in range(begin, end):
        encode_place(out, state, codes[n], unknown[n], chances)
    for s in range(len(firsts) - 1):
        if s == form:
            for n in range(begin, end):
                for k in range(masks.shape[1]):
                    size = mask_size(weights, logits[n, k])
                    if masks[n, k]:
                        encode_interval(out, state, ZERO, size, MASK_BITS)
                    else:
                        encode_interval(out, state, size, (ONE << MASK_BITS) - size, MASK_BITS)
        for n in range(begin, end):
            for c in range(firsts[s], firsts[s + 1]):
                if s < last or masks[n, (c - firsts[s]) // 3]:
                    encode_symbol(
                        out, state, np.int64(symbols[n, c]), ZERO, np.int64(scales[n, c]), ZERO, ZERO, NORMAL,
                        inverses, widths, table,
                    )  # fmt: skip
    return encoder_finish(out, state)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_packets(
    starts, codes, unknown, chances, masks, logits, symbols, scales, firsts, form, weights, inverses, widths, table,
    buffer, lengths,
):  # fmt: skip
    """Codes every packet into its own part of `buffer`; `lengths` receives the number of bytes.

    Stage s has the columns `firsts[s]:firsts[s + 1]`; the masks come before stage `form`, offsets are the last stage.
    """
    room, state = (masks.shape[1] + symbols.shape[1] + PLACE_SYMBOLS) * BYTES_PER_SYMBOL, np.empty(3, np.int64)
    for p in range(len(starts) - 1):
        lengths[p] = _encode_packet(
            starts[p], starts[p + 1], codes, unknown, chances, masks, logits, symbols, scales, firsts, form, weights,
            inverses, widths, table, buffer[starts[p] * room + 64 * p :], state,
        )  # fmt: skip


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def anchor_bits(
    codes, unknown, chances, masks, logits, symbols, scales, offsets, weights, inverses, widths, table, bits
):
    """Bits of each anchor; its offsets start at column `offsets`."""
    for n in range(masks.shape[0]):
        total = place_bits(codes[n], unknown[n], chances)
        for k in range(masks.shape[1]):
            size = mask_size(weights, logits[n, k])
            total += 16.0 - np.log2(float(size if masks[n, k] else 65536 - size))
        for c in range(symbols.shape[1]):
            if c >= offsets and not masks[n, (c - offsets) // 3]:
                continue
            symbol, scale = np.int64(symbols[n, c]), np.int64(scales[n, c])
            low, high = window(ZERO, scale, ZERO, ZERO, NORMAL, widths)
            if low <= symbol <= high:
                inverse = inverses[scale]
                a = cumulative(symbol, low, high, ZERO, inverse, ZERO, inverse, NORMAL, table)
                b = cumulative(symbol + 1, low, high, ZERO, inverse, ZERO, inverse, NORMAL, table)
                total += TOTAL_BITS - np.log2(float(b - a))
            else:
                excess = symbol - high - 1 if symbol > high else low - 1 - symbol
                total += TOTAL_BITS - np.log2(float(ESCAPE)) + 2.0 + 2.0 * np.floor(np.log2(float(excess + 1)))
        bits[n] = total


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def start_packets(data, ends, states):
    """Starts the decoder of every packet; `ends[p]:ends[p + 1]` are the packet's bytes."""
    for p in range(states.shape[0]):
        decoder_start(data, ends[p], ends[p + 1], states[p])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_masks(data, ends, starts, states, logits, weights, masks):
    """Reads which offsets exist."""
    for p in range(states.shape[0]):
        for n in range(starts[p], starts[p + 1]):
            for k in range(masks.shape[1]):
                size = mask_size(weights, logits[n, k])
                exists = decode_target(states[p], MASK_BITS) < size
                masks[n, k] = 1 if exists else 0
                if exists:
                    decode_advance(data, ends[p + 1], states[p], ZERO, size, MASK_BITS)
                else:
                    decode_advance(data, ends[p + 1], states[p], size, (ONE << MASK_BITS) - size, MASK_BITS)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_stage(data, ends, starts, states, scales, coded, inverses, widths, table, symbols):
    """Reads the symbols of a stage; number c is there if `coded[n, c // 3]`, and 0 if not."""
    for p in range(states.shape[0]):
        for n in range(starts[p], starts[p + 1]):
            for c in range(scales.shape[1]):
                symbols[n, c] = 0
                if coded[n, c // 3]:
                    symbol = decode_symbol(
                        data, ends[p + 1], states[p], ZERO, np.int64(scales[n, c]), ZERO, ZERO, NORMAL,
                        inverses, widths, table,
                    )  # fmt: skip
                    symbols[n, c] = min(max(symbol, -LARGEST_SYMBOL), LARGEST_SYMBOL)  # hostile ones have 33 bits
