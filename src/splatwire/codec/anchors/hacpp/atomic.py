"""Atomic packets: each contains all attributes of its anchors, and decodes without other packets.

This follows Section 3.2.1 of the paper that this project implements (docs/paper-map.md).
"""
# Encoding and decoding share the prediction. Packets are processed in chunks, which does not affect the bytes.

from dataclasses import dataclass

import numpy as np

from splatwire.codec.anchors.hacpp import _packet_kernels as kernels
from splatwire.codec.anchors.hacpp.coding_params import (
    CodingContext,
    PriorColumns,
    factor_table,
    inverse_step_table,
    prior_columns,
    step_indices,
)
from splatwire.entropy.coder import tables
from splatwire.entropy.tables import logistic_table
from splatwire.types import AnchorLayout


@dataclass(frozen=True, eq=False)
class Symbols:
    """Quantised attributes of N anchors.

    Attributes:
        mask: 1 for offsets that exist, uint8 (N, K).
        feature: Feature channels in quantisation steps, int32 (N, F).
        scaling: Scalings in quantisation steps, int32 (N, 6).
        offset: Offsets in quantisation steps, int32 (N, 3 K); zero for offsets that do not exist.
    """

    mask: np.ndarray
    feature: np.ndarray
    scaling: np.ndarray
    offset: np.ndarray

    def select(self, index: np.ndarray) -> "Symbols":
        """Returns the symbols (quantised attributes) of the anchors with the given indices."""
        return Symbols(self.mask[index], self.feature[index], self.scaling[index], self.offset[index])

    def rows(self) -> np.ndarray:
        """All symbols of each anchor in one row, int32 (N, symbols): mask, feature, scaling, offset."""
        return np.concatenate([self.mask.astype(np.int32), self.feature, self.scaling, self.offset], axis=1)

    @staticmethod
    def of_rows(rows: np.ndarray, layout: AnchorLayout) -> "Symbols":
        """Creates symbols from an array with all symbols of an anchor in each row; the inverse of the method `rows`.

        Args:
            rows: Symbols of each anchor, one attribute after another in the columns.
            layout: Number of offsets and of feature channels.
        """
        return Symbols(*np.split(rows, np.cumsum([layout.num_offsets, layout.feature_dim, 6]), axis=1))


@dataclass(frozen=True, eq=False)
class Predictions:
    """Distributions of the attributes of n anchors for entropy coding, predicted from the positions of the anchors.

    Scalings and offsets have normal distributions. Features have mixtures of two normal distributions. The second
    distribution of a feature depends on features that are decoded before; it is in the class `Mixture`.

    Attributes:
        outputs: Outputs of the prior network, int32 (n, outputs).
        factors: Factors by which the base quantisation steps of feature, scaling and offset are multiplied, in fixed
            point with `FACTOR_BITS` fractional bits, int64 (n, 3).
        feature: First of the two normal distributions of each feature, as two arrays (n, F): means in quantisation
            steps with 12 fractional bits, int32; and indices of the standard deviations in the coder's table, int16.
        scaling: The same two arrays for the scalings, (n, 6).
        offset: The same two arrays for the offsets, (n, 3 K).
    """

    outputs: np.ndarray
    factors: np.ndarray
    feature: tuple[np.ndarray, np.ndarray]
    scaling: tuple[np.ndarray, np.ndarray]
    offset: tuple[np.ndarray, np.ndarray]


def predict_packets(context: CodingContext, outputs: np.ndarray) -> Predictions:
    """Converts outputs of the prior network to probability distributions for the entropy coder.

    Args:
        context: The stream's networks and constants.
        outputs: Outputs of the prior network for n anchors, int32 (n, prior outputs).
    """
    config, columns = context.config, prior_columns(context.config)
    f, o = config.layout.feature_dim, 3 * config.layout.num_offsets
    factors = factor_table()[step_indices(outputs, config)]
    feature = _normal_indices(outputs, columns.feature_mean, columns.feature_scale, f, columns, 0, config.base_steps[0])
    scaling = _normal_indices(outputs, columns.scaling_mean, columns.scaling_scale, 6, columns, 1, config.base_steps[1])
    offset = _normal_indices(outputs, columns.offset_mean, columns.offset_scale, o, columns, 2, config.base_steps[2])
    return Predictions(outputs, factors, feature, scaling, offset)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Second component of each feature's mixture distribution, and weight of the first component.

    Attributes:
        mean: Means in quantisation steps with 12 fractional bits, int32 (n, F).
        scale: Indices of the standard deviations in the coder's table, int16 (n, F).
        weight: Index of the first component's weight in the coder's table of weights, uint8 (n, F).
    """

    mean: np.ndarray
    scale: np.ndarray
    weight: np.ndarray


def predict_mixture(context: CodingContext, predicted: Predictions, feature: np.ndarray) -> Mixture:
    """Computes the second component of each feature's mixture distribution, for an encoder.

    Args:
        context: The stream's networks and constants.
        predicted: Distributions predicted from the positions of the anchors.
        feature: Quantised features of the anchors, int32 (n, F).
    """
    # Each group of features is predicted from the groups before it. An encoder knows all features, so that all groups
    # can be predicted at once.
    edges = _group_edges(context)
    mean1 = np.empty((len(feature), int(edges[-1])), dtype=np.int32)
    scale1 = np.empty(mean1.shape, dtype=np.int16)
    weight = np.empty(mean1.shape, dtype=np.uint8)
    activations = context.feature_activations(feature, predicted.factors[:, 0])
    for group, shared in enumerate(context.shared_sums(predicted.outputs)):
        columns = slice(edges[group], edges[group + 1])
        parts = predict_group(context, group, shared, activations[:, : edges[group]], predicted.outputs)
        mean1[:, columns], scale1[:, columns], weight[:, columns] = parts
    return Mixture(mean1, scale1, weight)


def split_into_packets(
    predicted: Predictions,
    mixture: Mixture,
    counts: np.ndarray,
    symbols: Symbols,
    mask_models: np.ndarray,
    max_payload_bytes: int,
) -> np.ndarray:
    """Divides the anchors of each block, given in hash order, into packets of limited size with as many anchors as fit.

    Args:
        predicted: Predicted distributions of the anchors of all blocks, block by block.
        mixture: Second normal distribution of each feature's mixture, and the mixture weights.
        counts: Number of anchors in each block, int64 (blocks).
        symbols: Quantised attributes of the anchors.
        mask_models: Initial state of the adaptive bit models that code offset masks, int64 (contexts, 2). Every packet
            starts from it.
        max_payload_bytes: Maximum size of a payload; only a single anchor may exceed it.

    Returns:
        Number of anchors in each packet, int64; packets never cross the end of a block.
    """
    bits = np.empty(len(symbols.mask), dtype=np.float64)
    kernels.anchor_bits(
        symbols.mask, symbols.feature, symbols.scaling, symbols.offset,
        *predicted.feature, mixture.mean, mixture.scale, mixture.weight, *predicted.scaling, *predicted.offset,
        logistic_table(), *tables(), bits,
    )  # fmt: skip
    # The last byte is rounded up, and the coder's range loses up to 2**-16 of itself with each symbol.
    max_bits, block_counts, begin = 8.0 * (max_payload_bytes - 1) - 1.0, [], 0
    for count in counts.tolist():
        block, sizes = slice(begin, begin + count), np.empty(count, dtype=np.int64)
        num_packets = kernels.split_block(symbols.mask[block], bits[block], mask_models, max_bits, sizes)
        block_counts.append(sizes[:num_packets])
        begin += count
    return np.concatenate(block_counts) if block_counts else np.empty(0, dtype=np.int64)


def encode_packets(
    context: CodingContext,
    predicted: Predictions,
    counts: np.ndarray,
    symbols: Symbols,
    mask_models: np.ndarray,
    mixture: Mixture | None = None,
) -> list[bytes]:
    """Encodes the anchors of all packets; returns one payload per packet.

    Args:
        context: The stream's networks and constants.
        predicted: Predicted distributions of the anchors of all packets, packet by packet.
        counts: Number of anchors in each packet, int64 (packets).
        symbols: Quantised attributes of the anchors.
        mask_models: Initial state of the adaptive bit models that code offset masks, int64 (contexts, 2). Every packet
            starts from it.
        mixture: Second normal distribution of each feature's mixture, and the mixture weights; None to compute both.

    Returns:
        One payload per packet.
    """
    mixture = mixture or predict_mixture(context, predicted, symbols.feature)
    anchor_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    num, offsets, features = len(symbols.mask), symbols.mask.shape[1], symbols.feature.shape[1]
    max_anchor_bytes = (offsets + features + 6 + 3 * offsets) * kernels.BYTES_PER_SYMBOL
    buffer = np.empty(num * max_anchor_bytes + 64 * len(anchor_starts), dtype=np.uint8)
    lengths = np.zeros(len(anchor_starts) - 1, dtype=np.int64)
    kernels.encode_packets(
        anchor_starts, symbols.mask, symbols.feature, symbols.scaling, symbols.offset, mask_models,
        *predicted.feature, mixture.mean, mixture.scale, mixture.weight, *predicted.scaling, *predicted.offset,
        _group_edges(context), logistic_table(), *tables(), buffer, lengths,
    )  # fmt: skip
    begins = anchor_starts[:-1] * max_anchor_bytes + 64 * np.arange(len(lengths))
    return [buffer[begin : begin + length].tobytes() for begin, length in zip(begins, lengths, strict=True)]


def decode_packets(
    context: CodingContext,
    outputs: np.ndarray,
    counts: np.ndarray,
    payloads: list[bytes],
    mask_models: np.ndarray,
) -> tuple[Symbols, np.ndarray]:
    """Decodes packets; any bytes decode without an error.

    Args:
        context: The stream's networks and constants.
        outputs: Outputs of the prior network for the anchors of all packets, packet by packet, int32 (n, prior
            outputs).
        counts: Number of anchors in each packet, int64 (packets).
        payloads: One payload per packet.
        mask_models: Initial state of the adaptive bit models that code offset masks, int64 (contexts, 2). Every packet
            starts from it.

    Returns:
        Symbols of the anchors; and the factors by which the base quantisation steps of feature, scaling and offset are
        multiplied, in fixed point with `FACTOR_BITS` fractional bits, int64 (n, 3).
    """
    anchor_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    byte_starts = np.concatenate([[0], np.cumsum([len(p) for p in payloads])]).astype(np.int64)
    data = np.frombuffer(b"".join(payloads), dtype=np.uint8)
    predicted, edges = predict_packets(context, outputs), _group_edges(context)
    num, offsets = len(outputs), context.config.layout.num_offsets
    states = np.zeros((len(payloads), 3), dtype=np.int64)
    mask = np.empty((num, offsets), dtype=np.uint8)
    feature = np.empty((num, int(edges[-1])), dtype=np.int32)
    scaling, offset = np.empty((num, 6), dtype=np.int32), np.empty((num, 3 * offsets), dtype=np.int32)
    kernels.decode_masks(data, byte_starts, anchor_starts, mask_models, states, mask)
    for group, shared in enumerate(context.shared_sums(outputs)):
        before = context.feature_activations(feature[:, : edges[group]], predicted.factors[:, 0])
        mean1, scale1, weight = predict_group(context, group, shared, before, outputs)
        kernels.decode_group(
            data, byte_starts, anchor_starts, states, edges[group], *predicted.feature, mean1, scale1, weight,
            logistic_table(), *tables(), feature,
        )  # fmt: skip
    kernels.decode_scalings_and_offsets(
        data,
        byte_starts,
        anchor_starts,
        states,
        mask,
        *predicted.scaling,
        *predicted.offset,
        *tables(),
        scaling,
        offset,
    )
    return Symbols(mask, feature, scaling, offset), predicted.factors


def _group_edges(context: CodingContext) -> np.ndarray:
    return np.cumsum([0, *context.config.layout.feature_groups]).astype(np.int64)


def _normal_indices(
    outputs: np.ndarray, mean: int, scale: int, count: int, columns: PriorColumns, attribute: int, base: float
) -> tuple[np.ndarray, np.ndarray]:
    means = np.empty((len(outputs), count), dtype=np.int32)
    scales = np.empty((len(outputs), count), dtype=np.int16)
    kernels.gaussian_indices(outputs, mean, scale, columns.steps + attribute, inverse_step_table(base), means, scales)
    return means, scales


def predict_group(
    context: CodingContext, group: int, shared: np.ndarray, activations: np.ndarray, outputs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicts the second component of the mixture distributions of one feature group, for n anchors.

    Args:
        context: The stream's networks and constants.
        group: Index of the feature group.
        shared: Result of `CodingContext.shared_sums` for the group, float64 (n, hidden).
        activations: Decoded features of the preceding groups, from `CodingContext.feature_activations`, float64 (n,
            channels of the preceding groups).
        outputs: Outputs of the prior network, int32 (n, prior outputs).

    Returns:
        Three arrays (n, channels of the group): means in quantisation steps, indices of the standard deviations and
        indices of the weights in the coder's tables.
    """
    # The channel network of the group makes the prediction, from the outputs of the prior network and the decoded
    # features of the groups before.
    columns, size = prior_columns(context.config), context.config.layout.feature_groups[group]
    means = np.empty((len(outputs), size), dtype=np.int32)
    scales, weights = np.empty(means.shape, dtype=np.int16), np.empty(means.shape, dtype=np.uint8)
    kernels.mixture_indices(
        context.channel_outputs(group, shared, activations), outputs,
        columns.feature_weight + int(_group_edges(context)[group]), columns.steps,
        inverse_step_table(context.config.base_steps[0]), means, scales, weights,
    )  # fmt: skip
    return means, scales, weights
