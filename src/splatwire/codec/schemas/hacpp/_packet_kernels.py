"""Numba kernels that code the symbols of many packets at once, each packet a stream of its own.

Arrays of anchors are ordered packet by packet; `starts[p]:starts[p + 1]` are the anchors of packet p. Inside a packet
the order is: masks, feature groups one after another, scalings, unmasked offsets, each anchor by anchor.
"""

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import ESCAPE, NORMAL, cumulative, decode_symbol, encode_symbol, window
from splatwire.entropy.range_kernels import (
    ZERO,
    adaptive_size,
    adaptive_update,
    decode_bit,
    decoder_start,
    encode_bit,
    encoder_finish,
    encoder_start,
)
from splatwire.entropy.tables import TOTAL_BITS
from splatwire.ops.compiled import njit

BYTES_PER_SYMBOL = 12
"""Room for the costliest symbol: an escape of 86 bits."""

MASK_ONES = 4
"""Mask contexts per offset: 0, 1, 2 or more ones before it in the anchor."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def scale_index(scale):
    """Index into the scale table of a scale with 12 fractional bits: octave and 4 bits of mantissa."""
    value = min(max(scale, 64), (1 << 26) - 1)
    exponent = 6
    while value >> (exponent + 1):
        exponent += 1
    return ((exponent - 6) << 4) + ((value >> (exponent - 4)) & 15)


@njit(borrows=True, error_model="numpy")
@no_type_check
def step_index(q):
    """Index into the step table of an output with 16 fractional bits: 1024 cells per unit, clipped to -4 to 4."""
    return min(max(((q + 32) >> 6) + 4096, 0), 8192)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def gaussian_indices(outputs, mean_column, scale_column, q_column, inverse_steps, means, scales):
    """Turns network outputs (16 fractional bits) into means in steps (12 fractional bits) and scale indices."""
    count = means.shape[1]
    for n in range(means.shape[0]):
        inverse = inverse_steps[step_index(np.int64(outputs[n, q_column]))]
        for c in range(count):
            mean = (np.int64(outputs[n, mean_column + c]) * inverse) >> 20
            means[n, c] = min(max(mean, -2147483647), 2147483647)
            scale = (max(np.int64(outputs[n, scale_column + c]), 1) * inverse) >> 20
            scales[n, c] = scale_index(scale)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def mixture_indices(outputs, group, prior_outputs, weight_column, q_column, inverse_steps, means, scales, weights):
    """The same for a feature group's second component, and the index of the mixture weight."""
    size = means.shape[1]
    for n in range(means.shape[0]):
        inverse = inverse_steps[step_index(np.int64(prior_outputs[n, q_column]))]
        for c in range(size):
            mean = (np.int64(outputs[n, c]) * inverse) >> 20
            means[n, c] = min(max(mean, -2147483647), 2147483647)
            scales[n, c] = scale_index((max(np.int64(outputs[n, size + c]), 1) * inverse) >> 20)
            logit = np.int64(prior_outputs[n, weight_column + c]) - np.int64(outputs[n, 2 * size + c])
            weights[n, c] = min(max(((logit + 2048) >> 12) + 128, 0), 255)


@njit(borrows=True, error_model="numpy")
@no_type_check
def mask_context(offset, ones):
    """Context of a mask bit: which offset, and how many of the anchor's earlier offsets exist."""
    return offset * MASK_ONES + min(ones, MASK_ONES - 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_packets(
    starts, masks, features, scalings, offsets, mask_model,
    mean0, scale0, mean1, scale1, weight, scaling_mean, scaling_scale, offset_mean, offset_scale,
    group_starts, weights, inverses, widths, table, buffer, lengths,
):  # fmt: skip
    """Codes every packet into its own part of `buffer`; `lengths` receives the number of bytes.

    Packet p owns `buffer` from `starts[p]` times the capacity of an anchor, plus 64 bytes for each packet before it.
    """
    num_offsets = masks.shape[1]
    symbols = num_offsets + features.shape[1] + 6 + 3 * num_offsets
    for p in range(len(starts) - 1):
        begin, end = starts[p], starts[p + 1]
        out = buffer[begin * symbols * BYTES_PER_SYMBOL + 64 * p :]
        state = np.empty(3, np.int64)
        encoder_start(state)
        model = mask_model.copy()
        for n in range(begin, end):
            ones = ZERO
            for k in range(num_offsets):
                bit = np.int64(masks[n, k])
                encode_bit(out, state, model, mask_context(k, ones), bit)
                ones += bit
        for g in range(len(group_starts) - 1):
            for n in range(begin, end):
                for c in range(group_starts[g], group_starts[g + 1]):
                    encode_symbol(
                        out, state, np.int64(features[n, c]), np.int64(mean0[n, c]), np.int64(scale0[n, c]),
                        np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight[n, c]], inverses, widths, table,
                    )  # fmt: skip
        for n in range(begin, end):
            for c in range(6):
                encode_symbol(
                    out, state, np.int64(scalings[n, c]), np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]),
                    ZERO, ZERO, NORMAL, inverses, widths, table,
                )  # fmt: skip
        for n in range(begin, end):
            for k in range(num_offsets):
                if masks[n, k]:
                    for c in range(3 * k, 3 * k + 3):
                        encode_symbol(
                            out, state, np.int64(offsets[n, c]),
                            np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]),
                            ZERO, ZERO, NORMAL, inverses, widths, table,
                        )  # fmt: skip
        lengths[p] = encoder_finish(out, state)


@njit(borrows=True, error_model="numpy")
@no_type_check
def bits_of(symbol, mean0, scale0, mean1, scale1, weight, inverses, widths, table):
    """What `encode_symbol` spends on a symbol, in bits."""
    low, high = window(mean0, scale0, mean1, scale1, weight, widths)
    if low <= symbol <= high:
        a = cumulative(symbol, low, high, mean0, inverses[scale0], mean1, inverses[scale1], weight, table)
        b = cumulative(symbol + 1, low, high, mean0, inverses[scale0], mean1, inverses[scale1], weight, table)
        return TOTAL_BITS - np.log2(float(b - a))
    excess = symbol - high - 1 if symbol > high else low - 1 - symbol
    return TOTAL_BITS - np.log2(float(ESCAPE)) + 2.0 + 2.0 * np.floor(np.log2(float(excess + 1)))


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def anchor_bits(
    masks, features, scalings, offsets, mean0, scale0, mean1, scale1, weight,
    scaling_mean, scaling_scale, offset_mean, offset_scale, weights, inverses, widths, table, bits,
):  # fmt: skip
    """What every anchor costs beside its mask, in bits: it does not depend on what it shares a packet with."""
    for n in range(masks.shape[0]):
        total = 0.0
        for c in range(features.shape[1]):
            total += bits_of(
                np.int64(features[n, c]), np.int64(mean0[n, c]), np.int64(scale0[n, c]),
                np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight[n, c]], inverses, widths, table,
            )  # fmt: skip
        for c in range(6):
            total += bits_of(
                np.int64(scalings[n, c]), np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]), ZERO, ZERO,
                NORMAL, inverses, widths, table,
            )  # fmt: skip
        for c in range(offsets.shape[1]):
            if masks[n, c // 3]:
                total += bits_of(
                    np.int64(offsets[n, c]), np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]), ZERO, ZERO,
                    NORMAL, inverses, widths, table,
                )  # fmt: skip
        bits[n] = total


@njit(nogil=True, error_model="numpy")
@no_type_check
def cut(masks, bits, mask_model, budget, counts):
    """Cuts a run of anchors into packets of at most `budget` bits each; returns how many, `counts` gets their sizes.

    A packet's masks are coded with models of its own, so what a mask costs depends on where its packet begins.
    """
    packets, first, total = 0, 0, 0.0
    model = mask_model.copy()
    for n in range(masks.shape[0]):
        while True:
            cost, ones = bits[n], ZERO
            for k in range(masks.shape[1]):
                context = mask_context(k, ones)
                zero = adaptive_size(model, context)
                bit = np.int64(masks[n, k])
                cost += 16.0 - np.log2(float(65536 - zero if bit else zero))
                adaptive_update(model, context, bit)
                ones += bit
            if n == first or total + cost <= budget:
                break
            counts[packets] = n - first
            packets, first, total = packets + 1, n, 0.0
            model = mask_model.copy()
        total += cost
    if masks.shape[0]:
        counts[packets] = masks.shape[0] - first
        packets += 1
    return packets


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_masks(data, ends, starts, mask_model, states, masks):
    """Starts the decoder of every packet and reads its masks. `ends[p]:ends[p + 1]` are the packet's bytes."""
    num_offsets = masks.shape[1]
    for p in range(len(starts) - 1):
        state = states[p]
        decoder_start(data, ends[p], ends[p + 1], state)
        model = mask_model.copy()
        for n in range(starts[p], starts[p + 1]):
            ones = ZERO
            for k in range(num_offsets):
                bit = decode_bit(data, ends[p + 1], state, model, mask_context(k, ones))
                masks[n, k] = bit
                ones += bit


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_group(
    data, ends, starts, states, first, mean0, scale0, mean1, scale1, weight, weights, inverses, widths, table, features
):
    """Reads one feature group of every packet; the second component's arrays hold the group's columns only."""
    for p in range(len(starts) - 1):
        for n in range(starts[p], starts[p + 1]):
            for c in range(mean1.shape[1]):
                features[n, first + c] = decode_symbol(
                    data, ends[p + 1], states[p], np.int64(mean0[n, first + c]), np.int64(scale0[n, first + c]),
                    np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight[n, c]], inverses, widths, table,
                )  # fmt: skip


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_rest(
    data, ends, starts, states, masks, scaling_mean, scaling_scale, offset_mean, offset_scale,
    inverses, widths, table, scalings, offsets,
):  # fmt: skip
    """Reads scalings and unmasked offsets of every packet."""
    for p in range(len(starts) - 1):
        state, end = states[p], ends[p + 1]
        for n in range(starts[p], starts[p + 1]):
            for c in range(6):
                scalings[n, c] = decode_symbol(
                    data, end, state, np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]),
                    ZERO, ZERO, NORMAL, inverses, widths, table,
                )  # fmt: skip
        for n in range(starts[p], starts[p + 1]):
            for k in range(masks.shape[1]):
                for c in range(3 * k, 3 * k + 3):
                    offsets[n, c] = 0
                    if masks[n, k]:
                        offsets[n, c] = decode_symbol(
                            data, end, state, np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]),
                            ZERO, ZERO, NORMAL, inverses, widths, table,
                        )  # fmt: skip
