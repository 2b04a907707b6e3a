"""Encodes and decodes packets of the codec `causal`.

Each packet contains complete anchors and can be decoded without other packets.
"""
# Encoding and decoding share the prediction (`AutoregressivePredictor`). Packets are processed in chunks, which
# does not affect the bytes.

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.codec.anchors.causal import _kernels as kernels
from splatwire.codec.anchors.causal import _position_kernels as position_kernels
from splatwire.codec.anchors.causal.context import CodingContext, Stage, deviation_indices
from splatwire.codec.anchors.causal.positions import AnchorPositions
from splatwire.entropy.coder import tables
from splatwire.entropy.tables import logistic_table
from splatwire.ops.morton import morton_decode


@dataclass(frozen=True, eq=False)
class Quantised:
    """Anchors quantised for the causal model, with the predicted distributions of their attributes.

    Attributes:
        positions: Complete positions of the anchors, with high and low bits.
        masks: 1 for offsets that exist, uint8 (n, K).
        logits: Predicted logits of the masks, int32 (n, K).
        symbols: Differences of attributes from the predicted means in quantisation steps, int32 (n, attributes).
        deviation_indices: Index of each symbol's standard deviation in the coder's table, int16 (n, attributes).
        reconstructed: Decoded attributes in quantisation steps with 16 fractional bits, int32 (n, attributes):
            features, logarithms of the offset scale and of the three sizes, and offsets.
    """

    # `symbols` and `reconstructed` are 0 for missing offsets.

    positions: AnchorPositions
    masks: np.ndarray
    logits: np.ndarray
    symbols: np.ndarray
    deviation_indices: np.ndarray
    reconstructed: np.ndarray

    def rows(self) -> np.ndarray:
        """All integers of each anchor: position, mask and quantised attributes, int32 (n, 3 + K + attributes)."""
        return anchor_rows(self.positions.codes, self.masks, self.reconstructed)


def anchor_rows(codes: np.ndarray, masks: np.ndarray, reconstructed: np.ndarray) -> np.ndarray:
    """Returns all integers of each anchor: position, mask and quantised attributes, int32 (n, 3 + K + attributes)."""
    return np.concatenate([morton_decode(codes).astype(np.int32), masks.astype(np.int32), reconstructed], axis=1)


def _empty(context: CodingContext, positions: AnchorPositions, masks: np.ndarray) -> Quantised:
    last, num = context.stages[-1], len(masks)
    width = last.first + last.size
    return Quantised(
        positions, masks, np.empty(masks.shape, dtype=np.int32), np.zeros((num, width), dtype=np.int32),
        np.empty((num, width), dtype=np.int16), np.zeros((num, width), dtype=np.int32),
    )  # fmt: skip


def _columns(stage: Stage) -> slice:
    return slice(stage.first, stage.first + stage.size)


def quantise(
    context: CodingContext, positions: AnchorPositions, masks: np.ndarray, values: np.ndarray, offset_scale_step: float
) -> Quantised:
    """Quantises the attributes of anchors relative to the predictions of the causal model.

    Args:
        context: The stream's networks and constants.
        positions: Complete positions of the anchors, with high and low bits.
        masks: 1 for offsets that exist, uint8 (n, K).
        values: Attributes in quantisation steps, before rounding, float64 (n, attributes).
        offset_scale_step: Quantisation step of the offset scale's binary logarithm. The offset scale is rounded first,
            and the offsets are then corrected for its rounding error.
    """
    # Offsets are quantised last and relative to the decoded scale, so that they compensate for its rounding error.
    values = values.copy()
    quantised, predictor = _empty(context, positions, masks), context.start(positions.voxels)
    coded = np.repeat(masks.astype(bool), 3, axis=1)
    for stage, outputs in predictor.outputs():
        columns, means = _columns(stage), outputs[:, stage.num_mask_logits : stage.num_mask_logits + stage.size]
        if stage.num_mask_logits:
            quantised.logits[:] = outputs[:, : stage.num_mask_logits]
        symbols = np.rint(values[:, columns] - means * 2.0**-16).astype(np.int32)
        if stage is context.stages[-1]:
            symbols *= coded
        reconstructed = np.empty(symbols.shape, dtype=np.int32)
        kernels.add_predicted_means(symbols, outputs, stage.num_mask_logits, reconstructed)
        predictor.add_values(stage, reconstructed)
        if stage.num_mask_logits:
            rounding_error = values[:, columns] - reconstructed * 2.0**-16
            values[:, _columns(context.stages[-1])] *= np.exp2(rounding_error * offset_scale_step)
        if stage is context.stages[-1]:
            reconstructed *= coded
        quantised.symbols[:, columns], quantised.reconstructed[:, columns] = symbols, reconstructed
        quantised.deviation_indices[:, columns] = deviation_indices(
            np.ascontiguousarray(outputs[:, stage.num_mask_logits + stage.size :])
        )
    return quantised


def encode_packets(context: CodingContext, quantised: Quantised, counts: np.ndarray) -> list[bytes]:
    """Encodes the anchors of all packets; returns one payload per packet.

    Args:
        context: The stream's networks and constants.
        quantised: The quantised anchors of all packets, packet by packet.
        counts: Number of anchors in each packet, int64 (packets).
    """
    anchor_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    max_anchor_bytes = (
        quantised.masks.shape[1] + quantised.symbols.shape[1] + kernels.POSITION_SYMBOLS
    ) * kernels.BYTES_PER_SYMBOL
    buffer = np.empty(len(quantised.masks) * max_anchor_bytes + 64 * len(anchor_starts), dtype=np.uint8)
    lengths = np.zeros(len(counts), dtype=np.int64)
    first_columns = np.array([*(stage.first for stage in context.stages), quantised.symbols.shape[1]])
    mask_stage = next(s for s, stage in enumerate(context.stages) if stage.num_mask_logits)
    kernels.encode_packets(
        anchor_starts, quantised.positions.codes, quantised.positions.num_low_bits, context.low_bit_probabilities,
        quantised.masks, quantised.logits, quantised.symbols,
        quantised.deviation_indices, first_columns, mask_stage, logistic_table(), *tables(), buffer, lengths,
    )  # fmt: skip
    begins = anchor_starts[:-1] * max_anchor_bytes + 64 * np.arange(len(lengths))
    return [buffer[begin : begin + length].tobytes() for begin, length in zip(begins, lengths, strict=True)]


def anchor_bits(context: CodingContext, quantised: Quantised) -> np.ndarray:
    """Estimates how many bits each of n anchors takes in a packet, float64 (n).

    Args:
        context: The stream's networks and constants.
        quantised: The quantised anchors, with their predictions.
    """
    bits = np.empty(len(quantised.masks))
    kernels.anchor_bits(
        quantised.positions.codes, quantised.positions.num_low_bits, context.low_bit_probabilities, quantised.masks,
        quantised.logits,
        quantised.symbols, quantised.deviation_indices, context.stages[-1].first, logistic_table(), *tables(), bits,
    )  # fmt: skip
    return bits


def split_into_packets(
    context: CodingContext, quantised: Quantised, counts: np.ndarray, max_payload_bytes: int
) -> np.ndarray:
    """Divides the anchors of each block, given in hash order, into packets of limited size with as many anchors as fit.

    Args:
        context: The stream's networks and constants.
        quantised: The anchors of all blocks, block by block.
        counts: Number of anchors in each block, int64 (blocks).
        max_payload_bytes: Maximum size of a payload; only a single anchor may exceed it.

    Returns:
        Number of anchors in each packet, int64; packets never cross the end of a block.
    """
    # The last byte is rounded up, and the coder's range loses up to 2**-16 of itself with each symbol.
    bits = anchor_bits(context, quantised)
    max_bits, sizes, begin = 8.0 * (max_payload_bytes - 1) - 1.0, list[int](), 0
    for count in counts.tolist():
        first, total = begin, 0.0
        for n in range(begin, begin + count):
            if n > first and total + bits[n] > max_bits:
                sizes.append(n - first)
                first, total = n, 0.0
            total += bits[n]
        if count:
            sizes.append(begin + count - first)
        begin += count
    return np.array(sizes, dtype=np.int64)


def decode_packets(
    context: CodingContext, positions: AnchorPositions, counts: np.ndarray, payloads: Sequence[bytes]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decodes packets; any bytes decode without an error.

    Args:
        context: The stream's networks and constants.
        positions: Positions of the anchors of all packets, packet by packet, as known from side information.
        counts: Number of anchors in each packet, int64 (packets).
        payloads: One payload per packet.

    Returns:
        Three arrays with an entry for each anchor: Morton codes of the positions, int64 (n); offset masks, uint8 (n,
        K); and decoded attributes in quantisation steps with 16 fractional bits, int32 (n, attributes).
    """
    anchor_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    byte_starts = np.concatenate([[0], np.cumsum([len(p) for p in payloads])]).astype(np.int64)
    data = np.frombuffer(b"".join(payloads), dtype=np.uint8)
    states = np.zeros((len(payloads), 3), dtype=np.int64)
    kernels.start_packets(data, byte_starts, states)
    exact = replace(positions, codes=positions.codes.copy())
    position_kernels.decode_positions(
        data, byte_starts, anchor_starts, states, exact.codes, exact.num_low_bits, context.low_bit_probabilities
    )
    num, last = len(exact.codes), context.stages[-1]
    masks = np.zeros((num, context.config.layout.num_offsets), dtype=np.uint8)
    all_values = np.zeros((num, last.first + last.size), dtype=np.int32)
    all_coded = np.ones((num, -(-max(stage.size for stage in context.stages) // 3)), dtype=np.uint8)
    predictor = context.start(exact.voxels)
    for stage, outputs in predictor.outputs():
        if stage.num_mask_logits:
            logits = np.ascontiguousarray(outputs[:, : stage.num_mask_logits])
            kernels.decode_masks(data, byte_starts, anchor_starts, states, logits, logistic_table(), masks)
        indices = deviation_indices(np.ascontiguousarray(outputs[:, stage.num_mask_logits + stage.size :]))
        symbols, reconstructed = np.empty(indices.shape, dtype=np.int32), np.empty(indices.shape, dtype=np.int32)
        coded = masks if stage is last else all_coded
        kernels.decode_stage(data, byte_starts, anchor_starts, states, indices, coded, *tables(), symbols)
        kernels.add_predicted_means(symbols, outputs, stage.num_mask_logits, reconstructed)
        predictor.add_values(stage, reconstructed)
        all_values[:, _columns(stage)] = reconstructed
    all_values[:, last.first :] *= np.repeat(masks, 3, axis=1)
    return exact.codes, masks, all_values


def predict_from_positions(context: CodingContext, voxels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicts the distributions of all attributes of lost anchors, from the positions of the anchors alone.

    Args:
        context: The stream's networks and constants.
        voxels: Positions of the anchors, voxels, int64 (n, 3).

    Returns:
        Three arrays: outputs of the position network, float64 (n, outputs); predicted means in quantisation steps,
        int32 (n, attributes); and binary logarithms of the predicted standard deviations, int32 (n, attributes). The
        second and the third array have 16 fractional bits.
    """
    # The causal model predicts some attributes from others. Here, its networks get the predicted means of these. The
    # standard deviations do not include the uncertainty of these means.
    last, predictor = context.stages[-1], context.start(voxels)
    means = np.empty((len(voxels), last.first + last.size), dtype=np.int32)
    log_deviations = np.empty(means.shape, dtype=np.int32)
    for stage, outputs in predictor.outputs():
        mean = np.ascontiguousarray(outputs[:, stage.num_mask_logits : stage.num_mask_logits + stage.size])
        predictor.add_values(stage, mean)
        means[:, _columns(stage)], log_deviations[:, _columns(stage)] = (
            mean,
            outputs[:, stage.num_mask_logits + stage.size :],
        )
    return predictor.position_outputs, means, log_deviations
