"""Numba kernels that code the symbols of many packets at once.

Arrays of anchors are ordered packet by packet; `anchor_starts[p]:anchor_starts[p + 1]` are the anchors of packet p.
"""
# Each packet is a separate stream. Inside a packet the order is: masks, feature groups one after another, scalings,
# unmasked offsets, each anchor by anchor.

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import ESCAPE, NORMAL, cumulative, decode_symbol, encode_symbol, window
from splatwire.entropy.range_kernels import (
    ZERO,
    adaptive_update,
    decode_bit,
    decoder_start,
    encode_bit,
    encoder_finish,
    encoder_start,
    zero_probability,
)
from splatwire.entropy.tables import TOTAL_BITS
from splatwire.ops.compiled import njit

BYTES_PER_SYMBOL = 12
"""Buffer space per symbol, bytes. The longest code is an escape of 86 bits."""

MASK_CONTEXTS = 4
"""Mask contexts per offset: 0, 1, 2, or at least 3 earlier offsets of the anchor exist."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def scale_index(scale):
    """Returns the index of a standard deviation (12 fractional bits) in the entropy coder's table."""
    value = min(max(scale, 64), (1 << 26) - 1)
    exponent = 6
    while value >> (exponent + 1):
        exponent += 1
    return ((exponent - 6) << 4) + ((value >> (exponent - 4)) & 15)


@njit(borrows=True, error_model="numpy")
@no_type_check
def step_index(output):
    """Converts an output of the prior network to its index in the table of step factors (`factor_table`).

    Args:
        output: Network output with 16 fractional bits.
    """
    return min(max(((output + 32) >> 6) + 4096, 0), 8192)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def gaussian_indices(outputs, mean_column, scale_column, step_column, inverse_steps, means, scales):
    """Converts outputs of the prior network for one attribute to normal distributions for the entropy coder.

    Args:
        outputs: Outputs of the prior network, 16 fractional bits.
        mean_column: First column of the attribute's means.
        scale_column: First column of the attribute's standard deviations.
        step_column: Column of the output from which the attribute's quantisation step is computed.
        inverse_steps: Reciprocals of the steps, from `inverse_step_table`.
        means: Output: means in quantisation steps, 12 fractional bits.
        scales: Output: indices of the standard deviations in the coder's table.
    """
    count = means.shape[1]
    for n in range(means.shape[0]):
        inverse = inverse_steps[step_index(np.int64(outputs[n, step_column]))]
        for c in range(count):
            mean = (np.int64(outputs[n, mean_column + c]) * inverse) >> 20
            means[n, c] = min(max(mean, -2147483647), 2147483647)
            scale = (max(np.int64(outputs[n, scale_column + c]), 1) * inverse) >> 20
            scales[n, c] = scale_index(scale)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def mixture_indices(outputs, prior_outputs, weight_column, step_column, inverse_steps, means, scales, weights):
    """Converts outputs of a channel network to the second normal distribution and mixture weight of each feature.

    Features are coded with a mixture of two normals. The prior network predicts the first, and the channel network of
    the feature group predicts the second.

    Args:
        outputs: Outputs of the channel network for the group's channels: means, standard deviations, and mixture
            weights as logits.
        prior_outputs: Outputs of the prior network.
        weight_column: Column in `prior_outputs` with the logit of the first channel's mixture weight.
        step_column: Column in `prior_outputs` from which the quantisation step is computed.
        inverse_steps: Reciprocals of the steps, from `inverse_step_table`.
        means: Output: means of the second normal in quantisation steps, 12 fractional bits.
        scales: Output: indices of the second normal's standard deviations in the coder's table.
        weights: Output: weights of the first normal, as indices into the table of mixture weights.
    """
    size = means.shape[1]
    for n in range(means.shape[0]):
        inverse = inverse_steps[step_index(np.int64(prior_outputs[n, step_column]))]
        for c in range(size):
            mean = (np.int64(outputs[n, c]) * inverse) >> 20
            means[n, c] = min(max(mean, -2147483647), 2147483647)
            scales[n, c] = scale_index((max(np.int64(outputs[n, size + c]), 1) * inverse) >> 20)
            logit = np.int64(prior_outputs[n, weight_column + c]) - np.int64(outputs[n, 2 * size + c])
            weights[n, c] = min(max(((logit + 2048) >> 12) + 128, 0), 255)


@njit(borrows=True, error_model="numpy")
@no_type_check
def mask_context(offset, ones):
    """Returns the index of the adaptive model for a mask bit, which is 1 if an offset exists.

    Args:
        offset: Index of the offset within the anchor.
        ones: Number of earlier offsets of the anchor that exist.
    """
    # The context consists of the index of the offset and the number of the anchor's earlier offsets that exist.
    return offset * MASK_CONTEXTS + min(ones, MASK_CONTEXTS - 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_packets(
    anchor_starts, masks, features, scalings, offsets, mask_models,
    mean0, scale0, mean1, scale1, weight_indices, scaling_mean, scaling_scale, offset_mean, offset_scale,
    group_starts, weights, inverse_scales, widths, normal_cdf, buffer, lengths,
):  # fmt: skip
    """Encodes the anchors of all packets, each packet into its own part of `buffer`.

    Args:
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        masks: 1 for offsets that exist.
        features: Features in quantisation steps.
        scalings: Scalings in quantisation steps.
        offsets: Offsets in quantisation steps.
        mask_models: Initial state of the adaptive models of mask bits, equal for all packets.
        mean0: Means of the first mixture component of the features.
        scale0: Indices of the first component's standard deviations in the coder's table.
        mean1: Means of the second mixture component of the features.
        scale1: Indices of the second component's standard deviations in the coder's table.
        weight_indices: Weights of the first mixture component, as indices into `weights`.
        scaling_mean: Means of the scalings.
        scaling_scale: Indices of the standard deviations of the scalings in the coder's table.
        offset_mean: Means of the offsets.
        offset_scale: Indices of the standard deviations of the offsets in the coder's table.
        group_starts: First channel of each feature group, and the end of the last.
        weights: Table of mixture weights.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        buffer: Output bytes.
        lengths: Output: size of each packet in bytes.
    """
    # The part of packet p begins at `anchor_starts[p]` times the maximum size of an anchor, plus 64 bytes per preceding
    # packet.
    num_offsets = masks.shape[1]
    num_symbols = num_offsets + features.shape[1] + 6 + 3 * num_offsets
    for p in range(len(anchor_starts) - 1):
        begin, end = anchor_starts[p], anchor_starts[p + 1]
        out = buffer[begin * num_symbols * BYTES_PER_SYMBOL + 64 * p :]
        state = np.empty(3, np.int64)
        encoder_start(state)
        model = mask_models.copy()
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
                        np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight_indices[n, c]],
                        inverse_scales, widths, normal_cdf,
                    )  # fmt: skip
        for n in range(begin, end):
            for c in range(6):
                encode_symbol(
                    out, state, np.int64(scalings[n, c]), np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]),
                    ZERO, ZERO, NORMAL, inverse_scales, widths, normal_cdf,
                )  # fmt: skip
        for n in range(begin, end):
            for k in range(num_offsets):
                if masks[n, k]:
                    for c in range(3 * k, 3 * k + 3):
                        encode_symbol(
                            out, state, np.int64(offsets[n, c]),
                            np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]),
                            ZERO, ZERO, NORMAL, inverse_scales, widths, normal_cdf,
                        )  # fmt: skip
        lengths[p] = encoder_finish(out, state)


@njit(borrows=True, error_model="numpy")
@no_type_check
def bits_of(symbol, mean0, scale0, mean1, scale1, weight, inverse_scales, widths, normal_cdf):
    """Returns the ideal code length of a symbol under a mixture of two normal distributions, bits.

    Args:
        symbol: The symbol.
        mean0: Mean of the first component, see `entropy.coder.Mixtures`.
        scale0: Standard deviation of the first component, as an index into the coder's table.
        mean1: Mean of the second component.
        scale1: Standard deviation of the second component.
        weight: Weight of the first component, out of 2**16.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
    """
    low, high = window(mean0, scale0, mean1, scale1, weight, widths)
    if low <= symbol <= high:
        a = cumulative(
            symbol, low, high, mean0, inverse_scales[scale0], mean1, inverse_scales[scale1], weight, normal_cdf
        )
        b = cumulative(
            symbol + 1, low, high, mean0, inverse_scales[scale0], mean1, inverse_scales[scale1], weight, normal_cdf
        )
        return TOTAL_BITS - np.log2(float(b - a))
    excess = symbol - high - 1 if symbol > high else low - 1 - symbol
    return TOTAL_BITS - np.log2(float(ESCAPE)) + 2.0 + 2.0 * np.floor(np.log2(float(excess + 1)))


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def anchor_bits(
    masks, features, scalings, offsets, mean0, scale0, mean1, scale1, weight_indices,
    scaling_mean, scaling_scale, offset_mean, offset_scale, weights, inverse_scales, widths, normal_cdf, bits,
):  # fmt: skip
    """Estimates the coded size of each anchor in bits, without its offset mask.

    Args:
        masks: 1 for offsets that exist.
        features: Features in quantisation steps.
        scalings: Scalings in quantisation steps.
        offsets: Offsets in quantisation steps.
        mean0: Means of the first mixture component of the features.
        scale0: Indices of the first component's standard deviations in the coder's table.
        mean1: Means of the second mixture component of the features.
        scale1: Indices of the second component's standard deviations in the coder's table.
        weight_indices: Weights of the first mixture component, as indices into `weights`.
        scaling_mean: Means of the scalings.
        scaling_scale: Indices of the standard deviations of the scalings in the coder's table.
        offset_mean: Means of the offsets.
        offset_scale: Indices of the standard deviations of the offsets in the coder's table.
        weights: Table of mixture weights.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        bits: Output: size of each anchor, bits.
    """
    for n in range(masks.shape[0]):
        total = 0.0
        for c in range(features.shape[1]):
            total += bits_of(
                np.int64(features[n, c]), np.int64(mean0[n, c]), np.int64(scale0[n, c]),
                np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight_indices[n, c]],
                inverse_scales, widths, normal_cdf,
            )  # fmt: skip
        for c in range(6):
            total += bits_of(
                np.int64(scalings[n, c]), np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]), ZERO, ZERO,
                NORMAL, inverse_scales, widths, normal_cdf,
            )  # fmt: skip
        for c in range(offsets.shape[1]):
            if masks[n, c // 3]:
                total += bits_of(
                    np.int64(offsets[n, c]), np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]), ZERO, ZERO,
                    NORMAL, inverse_scales, widths, normal_cdf,
                )  # fmt: skip
        bits[n] = total


@njit(nogil=True, error_model="numpy")
@no_type_check
def split_block(masks, bits, mask_models, max_bits, counts):
    """Divides a block's anchors, given in hash order, into packets of limited size, each with as many as fit.

    Args:
        masks: Offset masks of the anchors, uint8 (n, K).
        bits: Bits of each anchor without its mask, from `anchor_bits`.
        mask_models: Initial state of the adaptive models of mask bits, equal for all packets.
        max_bits: Maximum size of a packet in bits.
        counts: Output: number of anchors of each packet.

    Returns:
        Number of packets.
    """
    # The number of bits of a mask depends on the preceding anchors of the packet, and is computed here.
    num_packets, first, total = 0, 0, 0.0
    model = mask_models.copy()
    for n in range(masks.shape[0]):
        while True:
            cost, ones = bits[n], ZERO
            for k in range(masks.shape[1]):
                context = mask_context(k, ones)
                probability = zero_probability(model, context)
                bit = np.int64(masks[n, k])
                cost += 16.0 - np.log2(float(65536 - probability if bit else probability))
                adaptive_update(model, context, bit)
                ones += bit
            if n == first or total + cost <= max_bits:
                break
            counts[num_packets] = n - first
            num_packets, first, total = num_packets + 1, n, 0.0
            model = mask_models.copy()
        total += cost
    if masks.shape[0]:
        counts[num_packets] = masks.shape[0] - first
        num_packets += 1
    return num_packets


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_masks(data, byte_starts, anchor_starts, mask_models, states, masks):
    """Decodes the offset masks of all packets' anchors, and initialises the range decoders of the packets.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        mask_models: Initial state of the adaptive models of mask bits, equal for all packets.
        states: Output: state of the range decoder of each packet.
        masks: Output: 1 for offsets that exist, else 0.
    """
    num_offsets = masks.shape[1]
    for p in range(len(anchor_starts) - 1):
        state = states[p]
        decoder_start(data, byte_starts[p], byte_starts[p + 1], state)
        model = mask_models.copy()
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            ones = ZERO
            for k in range(num_offsets):
                bit = decode_bit(data, byte_starts[p + 1], state, model, mask_context(k, ones))
                masks[n, k] = bit
                ones += bit


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_group(
    data,
    byte_starts,
    anchor_starts,
    states,
    first,
    mean0,
    scale0,
    mean1,
    scale1,
    weight_indices,
    weights,
    inverse_scales,
    widths,
    normal_cdf,
    features,
):
    """Decodes one feature group for the anchors of all packets.

    Each feature has a mixture of two normal distributions. The prior network, which predicts all groups, predicts the
    first distribution. The network of this group predicts the second distribution.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        first: First column of the group in `features`.
        mean0: Means of the first distribution, for the channels of all groups.
        scale0: Standard deviations of the first distribution as indices into the coder's table, for the channels of all
            groups.
        mean1: Means of the second distribution, for the channels of this group.
        scale1: Standard deviations of the second distribution as indices into the coder's table, for the channels of
            this group.
        weight_indices: Weights of the first distribution as indices into `weights`, for the channels of this group.
        weights: Table of mixture weights.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        features: Output: feature symbols.
    """
    for p in range(len(anchor_starts) - 1):
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            for c in range(mean1.shape[1]):
                features[n, first + c] = decode_symbol(
                    data, byte_starts[p + 1], states[p], np.int64(mean0[n, first + c]), np.int64(scale0[n, first + c]),
                    np.int64(mean1[n, c]), np.int64(scale1[n, c]), weights[weight_indices[n, c]],
                    inverse_scales, widths, normal_cdf,
                )  # fmt: skip


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_scalings_and_offsets(
    data, byte_starts, anchor_starts, states, masks, scaling_mean, scaling_scale, offset_mean, offset_scale,
    inverse_scales, widths, normal_cdf, scalings, offsets,
):  # fmt: skip
    """Decodes the scalings and the existing offsets of the anchors of all packets, after masks and features.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        masks: 1 for offsets that exist.
        scaling_mean: Means of the scalings.
        scaling_scale: Standard deviations of the scalings, as indices into the coder's table.
        offset_mean: Means of the offsets.
        offset_scale: Standard deviations of the offsets, as indices into the coder's table.
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        normal_cdf: Standard normal CDF, from `normal_table`.
        scalings: Output: scalings in quantisation steps.
        offsets: Output: offsets in quantisation steps; 0 for offsets that do not exist.
    """
    for p in range(len(anchor_starts) - 1):
        state, end = states[p], byte_starts[p + 1]
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            for c in range(6):
                scalings[n, c] = decode_symbol(
                    data, end, state, np.int64(scaling_mean[n, c]), np.int64(scaling_scale[n, c]),
                    ZERO, ZERO, NORMAL, inverse_scales, widths, normal_cdf,
                )  # fmt: skip
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            for k in range(masks.shape[1]):
                for c in range(3 * k, 3 * k + 3):
                    offsets[n, c] = 0
                    if masks[n, k]:
                        offsets[n, c] = decode_symbol(
                            data, end, state, np.int64(offset_mean[n, c]), np.int64(offset_scale[n, c]),
                            ZERO, ZERO, NORMAL, inverse_scales, widths, normal_cdf,
                        )  # fmt: skip
