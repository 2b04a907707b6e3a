"""Numba kernels of the codec `causal`: they convert network outputs to contexts, and code many packets at once.

Arrays of anchors are ordered packet by packet; `anchor_starts[p]:anchor_starts[p + 1]` are the anchors of packet p.
"""
# A packet contains the positions of its anchors, then their attributes in stages. A stage is a group of attributes that
# one network predicts at once (`context.Stage`). Masks, which indicate the offsets that exist, precede the stage of the
# scale. Only existing offsets are coded. `tests/reference/causal_packets.py` is an equivalent implementation in plain
# Python.

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
MAX_SYMBOL = (1 << 14) - (1 << 10)
"""Magnitude to which symbols (differences from predicted means) are clipped, because damaged packets may decode to any
integers. Encoders refuse attributes above `encoder.MAX_QUANTISED` steps.
"""
MASK_BITS = np.int64(16)
"""Number of bits of the probability that an offset exists (a bit of the mask): probabilities are in units of 2**-16."""
MIN_MASK_PROBABILITY = np.int64(32)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def values_to_inputs(values, inputs):
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
def deviation_indices(log_deviations, powers, indices):
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
            symbol = min(max(np.int64(symbols[n, c]), -MAX_SYMBOL), MAX_SYMBOL)
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
    return min(max(logistic_table[index], MIN_MASK_PROBABILITY), (1 << 16) - MIN_MASK_PROBABILITY)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _encode_packet(
    begin, end, codes, num_low_bits, low_bit_probabilities, masks, logits, symbols, deviation_indices, first_columns,
    mask_stage, logistic_table, inverse_scales, widths, normal_cdf, out, state,
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
        deviation_indices: Index of each symbol's standard deviation in the coder's table.
        first_columns: Index of the first column in `symbols` of each stage (group of attributes that are predicted
            together); the last item is the number of columns.
        mask_stage: Index of the stage of the offset scale. Its symbols are coded right after the masks, which the same
            network predicts.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        out: Output: bytes of the packet.
        state: Working array for the range encoder, int64 (3).
    """
    last_stage = len(first_columns) - 2
    encoder_start(state)
    for n in range(begin, end):
        encode_position(out, state, codes[n], num_low_bits[n], low_bit_probabilities)
    for stage in range(len(first_columns) - 1):
        if stage == mask_stage:
            for n in range(begin, end):
                for k in range(masks.shape[1]):
                    probability = offset_probability(logistic_table, logits[n, k])
                    if masks[n, k]:
                        encode_interval(out, state, ZERO, probability, MASK_BITS)
                    else:
                        encode_interval(out, state, probability, (ONE << MASK_BITS) - probability, MASK_BITS)
        for n in range(begin, end):
            for c in range(first_columns[stage], first_columns[stage + 1]):
                if stage < last_stage or masks[n, (c - first_columns[stage]) // 3]:
                    encode_symbol(
                        out, state, np.int64(symbols[n, c]), ZERO, np.int64(deviation_indices[n, c]), ZERO, ZERO,
                        NORMAL, inverse_scales, widths, normal_cdf,
                    )  # fmt: skip
    return encoder_finish(out, state)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_packets(
    anchor_starts, codes, num_low_bits, low_bit_probabilities, masks, logits, symbols, deviation_indices, first_columns,
    mask_stage, logistic_table, inverse_scales, widths, normal_cdf, buffer, lengths,
):  # fmt: skip
    """Encodes the anchors of all packets, each packet into its own part of `buffer`.

    Args:
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        codes: Morton codes of the anchors' positions.
        num_low_bits: Number of low bits of each Morton code that are coded in the packet; the high bits are side
            information.
        low_bit_probabilities: Probabilities for coding the low bits (`positions.CoarsePositions`).
        masks: 1 for offsets that exist.
        logits: Predicted logits of the masks.
        symbols: Quantised attributes, relative to the predicted means.
        deviation_indices: Index of each symbol's standard deviation in the coder's table.
        first_columns: Index of the first column in `symbols` of each stage (group of attributes that are predicted
            together); the last item is the number of columns.
        mask_stage: Index of the stage of the offset scale. Its symbols are coded right after the masks, which the same
            network predicts.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        buffer: Output bytes.
        lengths: Output: size of each packet in bytes.
    """
    capacity, state = (
        (masks.shape[1] + symbols.shape[1] + POSITION_SYMBOLS) * BYTES_PER_SYMBOL,
        np.empty(3, np.int64),
    )
    for p in range(len(anchor_starts) - 1):
        lengths[p] = _encode_packet(
            anchor_starts[p], anchor_starts[p + 1], codes, num_low_bits, low_bit_probabilities, masks, logits, symbols,
            deviation_indices, first_columns, mask_stage, logistic_table, inverse_scales, widths, normal_cdf,
            buffer[anchor_starts[p] * capacity + 64 * p :], state,
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
    deviation_indices,
    first_offset_column,
    logistic_table,
    inverse_scales,
    widths,
    normal_cdf,
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
        deviation_indices: Index of each symbol's standard deviation in the coder's table.
        first_offset_column: Index of the first column of `symbols` that belongs to offsets.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        bits: Output: size of each anchor, bits.
    """
    for n in range(masks.shape[0]):
        total = position_bits(codes[n], num_low_bits[n], low_bit_probabilities)
        for k in range(masks.shape[1]):
            probability = offset_probability(logistic_table, logits[n, k])
            total += 16.0 - np.log2(float(probability if masks[n, k] else 65536 - probability))
        for c in range(symbols.shape[1]):
            if c >= first_offset_column and not masks[n, (c - first_offset_column) // 3]:
                continue
            symbol, scale = np.int64(symbols[n, c]), np.int64(deviation_indices[n, c])
            low, high = window(ZERO, scale, ZERO, ZERO, NORMAL, widths)
            if low <= symbol <= high:
                inverse = inverse_scales[scale]
                a = cumulative(symbol, low, high, ZERO, inverse, ZERO, inverse, NORMAL, normal_cdf)
                b = cumulative(symbol + 1, low, high, ZERO, inverse, ZERO, inverse, NORMAL, normal_cdf)
                total += TOTAL_BITS - np.log2(float(b - a))
            else:
                excess = symbol - high - 1 if symbol > high else low - 1 - symbol
                total += TOTAL_BITS - np.log2(float(ESCAPE)) + 2.0 + 2.0 * np.floor(np.log2(float(excess + 1)))
        bits[n] = total


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def start_packets(data, byte_starts, states):
    """Initialises the range decoder of every packet.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        states: Output: state of the range decoder of each packet.
    """
    for p in range(states.shape[0]):
        decoder_start(data, byte_starts[p], byte_starts[p + 1], states[p])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_masks(data, byte_starts, anchor_starts, states, logits, logistic_table, masks):
    """Decodes the offset masks of the anchors of all packets.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        logits: Predicted logits of the masks.
        logistic_table: Table of probabilities by logit, see `offset_probability`.
        masks: Output: 1 for offsets that exist, else 0.
    """
    for p in range(states.shape[0]):
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            for k in range(masks.shape[1]):
                probability = offset_probability(logistic_table, logits[n, k])
                exists = decode_target(states[p], MASK_BITS) < probability
                masks[n, k] = 1 if exists else 0
                if exists:
                    decode_advance(data, byte_starts[p + 1], states[p], ZERO, probability, MASK_BITS)
                else:
                    decode_advance(
                        data, byte_starts[p + 1], states[p], probability, (ONE << MASK_BITS) - probability, MASK_BITS
                    )


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_stage(
    data, byte_starts, anchor_starts, states, deviation_indices, coded, inverse_scales, widths, normal_cdf, symbols
):
    """Decodes a group of attributes that are predicted together, for the anchors of all packets.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        deviation_indices: Index of each symbol's standard deviation in the coder's table.
        coded: Mask of the coded symbols; `coded[n, k]` is for columns 3 k to 3 k + 2 of anchor n.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        symbols: Output: symbols; 0 for symbols that are not coded.
    """
    for p in range(states.shape[0]):
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            for c in range(deviation_indices.shape[1]):
                symbols[n, c] = 0
                if coded[n, c // 3]:
                    symbol = decode_symbol(
                        data, byte_starts[p + 1], states[p], ZERO, np.int64(deviation_indices[n, c]), ZERO, ZERO,
                        NORMAL, inverse_scales, widths, normal_cdf,
                    )  # fmt: skip
                    symbols[n, c] = min(max(symbol, -MAX_SYMBOL), MAX_SYMBOL)  # malformed: up to 33 bits
