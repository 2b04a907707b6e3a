"""Numba kernels of the codec `causal`: they convert network outputs to contexts, and code many packets at once.

Arrays of anchors are ordered packet by packet; `starts[p]:starts[p + 1]` are the anchors of packet p.
"""
# A packet contains the positions of its anchors, then their attributes in stages. A stage is a group of attributes that
# one network predicts at once (`context.Stage`). Masks, which indicate the offsets that exist, precede the stage of the
# scale. Only existing offsets are coded. `tests/reference/causal_packets.py` is an equivalent implementation in plain
# torch.

from typing import no_type_check

import numpy as np

from splatwire.codec.anchors.causal._position_kernels import encode_position, position_bits
from splatwire.codec.fixed_point import ACTIVATION_LIMIT
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
"""Buffer space per symbol, bytes. The longest code is an escape of 86 bits."""
INPUT_SHIFT = 4
"""Right shift from quantised values with 16 fractional bits to network inputs with 14, which also divides by four."""
POSITION_SYMBOLS = 3
"""Buffer space of a position, in symbols; a position takes at most 29 bytes."""
LARGEST_SYMBOL = (1 << 14) - (1 << 10)
MASK_BITS = np.int64(16)
MASK_ROOM = np.int64(32)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def activate(values, inputs):
    """Converts quantised attributes of anchors to network inputs.

    Args:
        values: Attributes in quantisation steps, 16 fractional bits, (n, size).
        inputs: Output: the attributes divided by 4, with 14 fractional bits, clipped to the range of network inputs,
            (n, size).
    """
    for n in range(values.shape[0]):
        for c in range(values.shape[1]):
            value = np.int64(values[n, c]) >> INPUT_SHIFT
            inputs[n, c] = min(max(value, -ACTIVATION_LIMIT), ACTIVATION_LIMIT)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def scale_indices(log_deviations, powers, indices):
    """Converts standard deviations to indices into the entropy coder's table of standard deviations.

    Args:
        log_deviations: Binary logarithms of standard deviations, 16 fractional bits.
        powers: Table of powers of two, from `exp2_table(8, 20)`.
        indices: Output, same shape as `log_deviations`.
    """
    # The table has sixteen entries for each octave (power of two).
    for n in range(log_deviations.shape[0]):
        for c in range(log_deviations.shape[1]):
            shifted = np.int64(log_deviations[n, c]) + (6 << 16)
            fraction = (powers[(shifted >> 8) & 255] - (1 << 20)) >> 16
            indices[n, c] = min(max(((shifted >> 16) << 4) + fraction, 0), 319)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def add_predicted_means(symbols, outputs, first, reconstructed):
    """Reconstructs attributes of anchors: adds the decoded differences to the means that a network predicts.

    Args:
        symbols: Decoded differences in quantisation steps, (n, size).
        outputs: Outputs of the network, 16 fractional bits.
        first: First column of the means in `outputs`.
        reconstructed: Output: reconstructed attributes in quantisation steps, 16 fractional bits, (n, size).
    """
    for n in range(reconstructed.shape[0]):
        for c in range(reconstructed.shape[1]):
            symbol = min(max(np.int64(symbols[n, c]), -LARGEST_SYMBOL), LARGEST_SYMBOL)
            reconstructed[n, c] = np.int64(outputs[n, first + c]) + (symbol << 16)


@njit(borrows=True, error_model="numpy")
@no_type_check
def offset_probability(logistic_table, logit):
    """Returns the predicted probability that an offset exists, in units of 2**-16.

    Args:
        logistic_table: Table of the logistic function, the probability for each of 256 quantised logits.
        logit: Predicted logit, 16 fractional bits.
    """
    index = min(max(((np.int64(logit) + 2048) >> 12) + 128, 0), 255)
    return min(max(logistic_table[index], MASK_ROOM), (1 << 16) - MASK_ROOM)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _encode_packet(
    begin, end, codes, num_low_bits, low_bit_probabilities, masks, logits, symbols, scale_indices, firsts, size_group,
    logistic_table, inverses, widths, table, out, state,
):  # fmt: skip
    """Encodes consecutive anchors as one packet, and returns the size of the packet in bytes.

    Args:
        begin: Index of the packet's first anchor.
        end: End of the packet's anchors (exclusive).
        codes: Morton codes of the positions of all anchors.
        num_low_bits: Number of low bits of each Morton code that are coded in packets; the high bits are side
            information.
        low_bit_probabilities: Probabilities for coding the low bits (`positions.CoarsePositions`).
        masks: 1 for offsets that exist.
        logits: Predicted logits of the masks.
        symbols: Quantised attributes, relative to the predicted means.
        scale_indices: Index of each symbol's standard deviation in the coder's table.
        firsts: Index of the first column in `symbols` of each group of attributes that are predicted together; the last
            item is the number of columns.
        size_group: Index of the attribute group that is coded right after the masks: the sizes of the anchor.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
        out: Output: bytes of the packet.
        state: Working array for the range encoder, int64 (3).
    """
    last = len(firsts) - 2
    encoder_start(state)
    for n in range(begin, end):
        encode_position(out, state, codes[n], num_low_bits[n], low_bit_probabilities)
    for s in range(len(firsts) - 1):
        if s == size_group:
            for n in range(begin, end):
                for k in range(masks.shape[1]):
                    size = offset_probability(logistic_table, logits[n, k])
                    if masks[n, k]:
                        encode_interval(out, state, ZERO, size, MASK_BITS)
                    else:
                        encode_interval(out, state, size, (ONE << MASK_BITS) - size, MASK_BITS)
        for n in range(begin, end):
            for c in range(firsts[s], firsts[s + 1]):
                if s < last or masks[n, (c - firsts[s]) // 3]:
                    encode_symbol(
                        out, state, np.int64(symbols[n, c]), ZERO, np.int64(scale_indices[n, c]), ZERO, ZERO, NORMAL,
                        inverses, widths, table,
                    )  # fmt: skip
    return encoder_finish(out, state)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_packets(
    starts, codes, num_low_bits, low_bit_probabilities, masks, logits, symbols, scale_indices, firsts, size_group,
    logistic_table, inverses, widths, table, buffer, lengths,
):  # fmt: skip
    """Encodes the anchors of all packets, each packet into its own part of `buffer`.

    Args:
        starts: Packet p has the anchors from `starts[p]` to `starts[p + 1]` (exclusive).
        codes: Morton codes of the anchors' positions.
        num_low_bits: Number of low bits of each Morton code that are coded in the packet; the high bits are side
            information.
        low_bit_probabilities: Probabilities for coding the low bits (`positions.CoarsePositions`).
        masks: 1 for offsets that exist.
        logits: Predicted logits of the masks.
        symbols: Quantised attributes, relative to the predicted means.
        scale_indices: Index of each symbol's standard deviation in the coder's table.
        firsts: Index of the first column in `symbols` of each group of attributes that are predicted together; the last
            item is the number of columns.
        size_group: Index of the attribute group that is coded right after the masks: the sizes of the anchor.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
        buffer: Output bytes.
        lengths: Output: size of each packet in bytes.
    """
    capacity, state = (
        (masks.shape[1] + symbols.shape[1] + POSITION_SYMBOLS) * BYTES_PER_SYMBOL,
        np.empty(3, np.int64),
    )
    for p in range(len(starts) - 1):
        lengths[p] = _encode_packet(
            starts[p], starts[p + 1], codes, num_low_bits, low_bit_probabilities, masks, logits, symbols, scale_indices,
            firsts, size_group, logistic_table, inverses, widths, table, buffer[starts[p] * capacity + 64 * p :], state,
        )  # fmt: skip


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def anchor_bits(
    codes,
    num_low_bits,
    low_bit_probabilities,
    masks,
    logits,
    symbols,
    scale_indices,
    offsets,
    logistic_table,
    inverses,
    widths,
    table,
    bits,
):
    """Estimates the coded size of each anchor in bits.

    Args:
        codes: Morton codes of the anchors' positions.
        num_low_bits: Number of low bits of each Morton code that are coded in packets.
        low_bit_probabilities: Probabilities for coding the low bits (`positions.CoarsePositions`).
        masks: 1 for offsets that exist.
        logits: Predicted logits of the masks.
        symbols: Quantised attributes, relative to the predicted means; one row for each anchor.
        scale_indices: Index of each symbol's standard deviation in the coder's table.
        offsets: Index of the first column of `symbols` that belongs to offsets.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
        bits: Output: size of each anchor, bits.
    """
    for n in range(masks.shape[0]):
        total = position_bits(codes[n], num_low_bits[n], low_bit_probabilities)
        for k in range(masks.shape[1]):
            size = offset_probability(logistic_table, logits[n, k])
            total += 16.0 - np.log2(float(size if masks[n, k] else 65536 - size))
        for c in range(symbols.shape[1]):
            if c >= offsets and not masks[n, (c - offsets) // 3]:
                continue
            symbol, scale = np.int64(symbols[n, c]), np.int64(scale_indices[n, c])
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
    """Initialises the range decoder of every packet.

    Args:
        data: Bytes of all packets.
        ends: Packet p has the bytes from `ends[p]` to `ends[p + 1]` (exclusive) of `data`.
        states: Output: state of the range decoder of each packet.
    """
    for p in range(states.shape[0]):
        decoder_start(data, ends[p], ends[p + 1], states[p])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_masks(data, ends, starts, states, logits, logistic_table, masks):
    """Decodes the offset masks of the anchors of all packets.

    Args:
        data: Bytes of all packets.
        ends: Packet p has the bytes from `ends[p]` to `ends[p + 1]` (exclusive) of `data`.
        starts: Packet p has the anchors from `starts[p]` to `starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        logits: Predicted logits of the masks.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        masks: Output: 1 for offsets that exist, else 0.
    """
    for p in range(states.shape[0]):
        for n in range(starts[p], starts[p + 1]):
            for k in range(masks.shape[1]):
                size = offset_probability(logistic_table, logits[n, k])
                exists = decode_target(states[p], MASK_BITS) < size
                masks[n, k] = 1 if exists else 0
                if exists:
                    decode_advance(data, ends[p + 1], states[p], ZERO, size, MASK_BITS)
                else:
                    decode_advance(data, ends[p + 1], states[p], size, (ONE << MASK_BITS) - size, MASK_BITS)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_stage(data, ends, starts, states, scale_indices, coded, inverses, widths, table, symbols):
    """Decodes a group of attributes that are predicted together, for the anchors of all packets.

    Args:
        data: Bytes of all packets.
        ends: Packet p has the bytes from `ends[p]` to `ends[p + 1]` (exclusive) of `data`.
        starts: Packet p has the anchors from `starts[p]` to `starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        scale_indices: Index of each symbol's standard deviation in the coder's table.
        coded: Mask of the coded symbols; `coded[n, k]` is for columns 3 k to 3 k + 2 of anchor n.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
        symbols: Output: symbols; 0 for symbols that are not coded.
    """
    for p in range(states.shape[0]):
        for n in range(starts[p], starts[p + 1]):
            for c in range(scale_indices.shape[1]):
                symbols[n, c] = 0
                if coded[n, c // 3]:
                    symbol = decode_symbol(
                        data, ends[p + 1], states[p], ZERO, np.int64(scale_indices[n, c]), ZERO, ZERO, NORMAL,
                        inverses, widths, table,
                    )  # fmt: skip
                    symbols[n, c] = min(max(symbol, -LARGEST_SYMBOL), LARGEST_SYMBOL)  # malformed: up to 33 bits
