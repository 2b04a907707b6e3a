"""Separated packets: HAC++'s own layout, with a separate packet for each attribute of a group of anchors.

Used for comparison with atomic packets, which contain all attributes of their anchors.
"""
# The symbols and their distributions are the same as in atomic packets. A feature group can only be decoded with all
# groups before it. The offset masks of the whole scene are one section of the side information, like HAC++'s `masks.b`,
# because decoding offsets requires them.

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream.packet_id import FIRST_FEATURE, OFFSET, SCALING
from splatwire.codec.anchors.hacpp import _packet_kernels as kernels
from splatwire.codec.anchors.hacpp.atomic import Mixture, Predictions, Symbols, predict_group, predict_packets
from splatwire.codec.anchors.hacpp.coding_params import CodingContext
from splatwire.codec.anchors.hacpp.side_info import SideInfo
from splatwire.entropy.coder import Mixtures, decode_symbols, encode_bits, encode_symbols
from splatwire.entropy.tables import logistic_table
from splatwire.errors import BitstreamError
from splatwire.types import Attribute

SECTION = "masks"
"""Name of the section of the side information with the masks."""


def encode_masks(masks: np.ndarray, mask_models: np.ndarray) -> bytes:
    """Entropy-codes the offset masks of all anchors of a scene, for a section of the side information.

    Args:
        masks: Masks of the anchors in coding order, bool or uint8 (N, K).
        mask_models: Initial state of the adaptive bit models that code offset masks, int64 (contexts, 2).
    """
    bits = masks.astype(np.int64)
    before = np.minimum(np.cumsum(bits, axis=1) - bits, kernels.MASK_CONTEXTS - 1)
    contexts = np.arange(bits.shape[1])[None, :] * kernels.MASK_CONTEXTS + before
    return encode_bits(bits.ravel(), contexts.ravel(), mask_models)


def decode_masks(info: SideInfo) -> np.ndarray:
    """Decodes the offset masks of all anchors from the side information of a stream with separated packets.

    Returns:
        Masks of the anchors in coding order, uint8 (N, K).

    Raises:
        BitstreamError: If the side information has no section of masks.
    """
    if SECTION not in info.sections:
        raise BitstreamError(f"the side information lacks the section '{SECTION}', which separated packets need")
    data = info.sections[SECTION]
    masks = np.empty((len(info.voxels), info.config.layout.num_offsets), dtype=np.uint8)
    kernels.decode_masks(
        np.frombuffer(data, dtype=np.uint8), np.array([0, len(data)]), np.array([0, len(masks)]), info.mask_models(),
        np.zeros((1, 3), dtype=np.int64), masks,
    )  # fmt: skip
    return masks


def encode_parts(
    context: CodingContext, predicted: Predictions, mixture: Mixture, counts: np.ndarray, symbols: Symbols
) -> list[bytes]:
    """Encodes groups of anchors with a separate packet for each attribute, as HAC++ does.

    Args:
        context: The stream's networks and constants.
        predicted: Predicted probability distributions of the anchors' attributes, sorted by group.
        mixture: Second normal distribution of each feature's mixture, and the mixture weights.
        counts: Number of anchors in each group, int64 (groups).
        symbols: Quantised attributes of the anchors.

    Returns:
        The payloads of all packets, one group of anchors after another. The packets of a group contain scalings, then
        offsets, then each group of feature channels.
    """
    payloads, begin, edges = [], 0, _edges(context)
    for count in counts.tolist():
        rows = slice(begin, begin + count)
        scaling = _normal_distributions(predicted.scaling, rows)
        payloads.append(encode_symbols(symbols.scaling[rows].ravel(), scaling))
        exists = np.repeat(symbols.mask[rows].astype(bool), 3, axis=1)
        payloads.append(
            encode_symbols(symbols.offset[rows][exists], _normal_distributions(predicted.offset, rows, exists))
        )
        for first, last in itertools.pairwise(edges):
            columns = slice(int(first), int(last))
            parts = (mixture.mean[rows, columns], mixture.scale[rows, columns], mixture.weight[rows, columns])
            distribution = _feature_mixtures(predicted, rows, columns, *parts)
            payloads.append(encode_symbols(symbols.feature[rows, columns].ravel(), distribution))
        begin += count
    return payloads


@dataclass(frozen=True, eq=False)
class DecodedParts:
    """Decoded attributes of n anchors.

    Attributes:
        symbols: Quantised attributes of the anchors; zero for missing attributes.
        factors: Factors on the quantisation steps of feature, scaling and offset, int64 (n, 3).
        received: Mask of received attributes, bool (n, 4), one column per `Attribute`.
    """

    # If only the first channels of a feature were decoded, they are in `symbols`, and the entry of the feature in
    # `received` is False.

    symbols: Symbols
    factors: np.ndarray
    received: np.ndarray


def decode_parts(
    context: CodingContext, outputs: np.ndarray, mask: np.ndarray, payloads: Mapping[int, bytes]
) -> DecodedParts:
    """Decodes the received attributes of one group of anchors. Damaged payloads give wrong values, but never an error.

    Args:
        context: The stream's networks and constants.
        outputs: Outputs of the prior network for these anchors, int32 (n, prior outputs).
        mask: Mask of the offsets that exist, uint8 (n, K).
        payloads: Payloads of the received packets, by attribute (`PacketId.part`).
    """
    predicted, layout, num = predict_packets(context, outputs), context.config.layout, len(outputs)
    symbols = Symbols(
        mask,
        np.zeros((num, layout.feature_dim), dtype=np.int32),
        np.zeros((num, 6), dtype=np.int32),
        np.zeros((num, 3 * layout.num_offsets), dtype=np.int32),
    )
    rows, received = slice(0, num), np.zeros((num, len(Attribute)), dtype=np.bool_)
    received[:, Attribute.MASK] = True
    if SCALING in payloads:
        values = decode_symbols(payloads[SCALING], _normal_distributions(predicted.scaling, rows))
        symbols.scaling[:] = values.reshape(num, 6)
        received[:, Attribute.SCALING] = True
    if OFFSET in payloads:
        exists = np.repeat(mask.astype(bool), 3, axis=1)
        symbols.offset[exists] = decode_symbols(payloads[OFFSET], _normal_distributions(predicted.offset, rows, exists))
        received[:, Attribute.OFFSET] = True
    received[:, Attribute.FEATURE] = _decode_features(context, predicted, symbols.feature, payloads)
    return DecodedParts(symbols, predicted.factors, received)


def _decode_features(
    context: CodingContext, predicted: Predictions, feature: np.ndarray, payloads: Mapping[int, bytes]
) -> bool:
    """Decodes feature groups of anchors in order, up to the first group that was not received.

    Args:
        context: The stream's networks and constants.
        predicted: Distributions predicted from the positions of the anchors.
        feature: Output: features in quantisation steps, int32 (n, F).
        payloads: Payloads of the received packets, by attribute (`PacketId.part`).

    Returns:
        True if all feature groups were received and decoded, False if the decoding ended at a missing group.
    """
    # Channels of groups that are not decoded stay unchanged.
    edges, rows = _edges(context), slice(0, len(feature))
    for group, shared in enumerate(context.shared_sums(predicted.outputs)):
        if FIRST_FEATURE + group not in payloads:
            return False
        columns = slice(int(edges[group]), int(edges[group + 1]))
        before = context.feature_activations(feature[:, : columns.start], predicted.factors[:, 0])
        parts = predict_group(context, group, shared, before, predicted.outputs)
        values = decode_symbols(payloads[FIRST_FEATURE + group], _feature_mixtures(predicted, rows, columns, *parts))
        feature[:, columns] = values.reshape(len(feature), -1)
    return True


def _edges(context: CodingContext) -> np.ndarray:
    return np.cumsum([0, *context.config.layout.feature_groups])


def _normal_distributions(
    pair: tuple[np.ndarray, np.ndarray], rows: slice, exists: np.ndarray | None = None
) -> Mixtures:
    """Returns the normal distributions for coding scalings or offsets of anchors.

    Args:
        pair: Means, (n, D), and standard deviations as indices into the coder's table, (n, D), for all n anchors.
        rows: Range of the anchors to code.
        exists: Mask of the values that packets contain, for the m anchors in `rows`, bool (m, D); None if packets
            contain all.
    """
    mean, scale = (values[rows] if exists is None else values[rows][exists] for values in pair)
    return Mixtures.normals(mean.ravel(), scale.ravel())


def _feature_mixtures(
    predicted: Predictions, rows: slice, columns: slice, mean: np.ndarray, scale: np.ndarray, weight: np.ndarray
) -> Mixtures:
    """Returns the mixture distributions for coding one feature group of anchors.

    Args:
        predicted: Distributions predicted from the positions of all anchors, among them the first of the two normal
            distributions of each feature.
        rows: Range of the anchors.
        columns: Range of the group's channels.
        mean: Means of the second of the two mixed normal distributions, for these anchors and channels.
        scale: Indices of the second distribution's standard deviations in the coder's table.
        weight: Weight of the first distribution, as indices in the coder's table of weights.
    """
    first = (values[rows, columns] for values in predicted.feature)
    parts = (*first, mean, scale, logistic_table()[weight])
    return Mixtures(*(part.astype(np.int64).ravel() for part in parts))
