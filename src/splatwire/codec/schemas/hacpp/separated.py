"""Separated packets: HAC++'s own layout, in which each attribute of some anchors is a stream of its own.

The baseline that atomic packets are measured against. The symbols and their distributions are those of atomic packets;
a feature group is predicted from the groups before it, so it cannot be read without them. The offset masks are one
stream for the whole scene, as HAC++'s `masks.b` is, and side information like its hash grid: no offset can be read
without them.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.hacpp.atomic import Mixture, Predictions, Symbols, predict_group, predict_packets
from splatwire.codec.schemas.hacpp.coding_params import CodingContext
from splatwire.codec.schemas.hacpp.side_info import SideInfo
from splatwire.entropy.coder import Mixtures, decode_symbols, encode_bits, encode_symbols
from splatwire.entropy.tables import weight_table
from splatwire.errors import BitstreamError
from splatwire.packets.packet_id import FIRST_FEATURE, OFFSET, SCALING
from splatwire.scene import Attribute

SECTION = "masks"
"""Name of the section of the side information that holds the masks."""


def encode_masks(masks: np.ndarray, mask_models: np.ndarray) -> bytes:
    """Codes the masks of all anchors as one stream.

    Args:
        masks: bool or uint8 (N, K), by rank.
        mask_models: Initial mask models, int64 (contexts, 2).
    """
    from splatwire.codec.schemas.hacpp import _packet_kernels as kernels

    bits = masks.astype(np.int64)
    before = np.minimum(np.cumsum(bits, axis=1) - bits, kernels.MASK_ONES - 1)
    contexts = np.arange(bits.shape[1])[None, :] * kernels.MASK_ONES + before
    return encode_bits(bits.ravel(), contexts.ravel(), mask_models)


def decode_masks(info: SideInfo) -> np.ndarray:
    """Masks of all anchors of a stream with separated packets, by rank; any bytes decode to something.

    Returns:
        uint8 (N, K).

    Raises:
        BitstreamError: If the side information has none.
    """
    from splatwire.codec.schemas.hacpp import _packet_kernels as kernels

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
    """Codes the parts of some groups of anchors.

    Args:
        context: What both ends predict from.
        predicted: Prediction of the anchors, group by group.
        mixture: Their mixtures.
        counts: int64 (groups), anchors of each.
        symbols: The anchors' symbols.

    Returns:
        The payloads of each group's packets in the order of `PacketPlan.ids`: scalings, offsets, feature groups.
    """
    payloads, begin, edges = [], 0, _edges(context)
    for count in counts.tolist():
        rows = slice(begin, begin + count)
        scaling = _normals(predicted.scaling, rows)
        payloads.append(encode_symbols(symbols.scaling[rows].ravel(), scaling))
        keep = np.repeat(symbols.mask[rows].astype(bool), 3, axis=1)
        payloads.append(encode_symbols(symbols.offset[rows][keep], _normals(predicted.offset, rows, keep)))
        for first, last in itertools.pairwise(edges):
            columns = slice(int(first), int(last))
            parts = (mixture.mean[rows, columns], mixture.scale[rows, columns], mixture.weight[rows, columns])
            distribution = _features(predicted, rows, columns, *parts)
            payloads.append(encode_symbols(symbols.feature[rows, columns].ravel(), distribution))
        begin += count
    return payloads


@dataclass(frozen=True, eq=False)
class DecodedParts:
    """What could be read of n anchors.

    Attributes:
        symbols: Their symbols; zero where they could not be read.
        factors: Their step factors, int64 (n, 3).
        received: bool (n, 4), one column per `Attribute`. A feature of which some groups could be read has its
            channels in `symbols` and False here.
    """

    symbols: Symbols
    factors: np.ndarray
    received: np.ndarray


def decode_parts(
    context: CodingContext, outputs: np.ndarray, mask: np.ndarray, payloads: Mapping[int, bytes]
) -> DecodedParts:
    """Decodes what arrived of one group of anchors; any bytes decode to something.

    Args:
        context: What both ends predict from.
        outputs: int32 (n, prior outputs) of the anchors.
        mask: uint8 (n, K), their masks.
        payloads: Payloads of the packets that arrived, by `PacketId.part`.
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
        values = decode_symbols(payloads[SCALING], _normals(predicted.scaling, rows))
        symbols.scaling[:] = values.reshape(num, 6)
        received[:, Attribute.SCALING] = True
    if OFFSET in payloads:
        keep = np.repeat(mask.astype(bool), 3, axis=1)
        symbols.offset[keep] = decode_symbols(payloads[OFFSET], _normals(predicted.offset, rows, keep))
        received[:, Attribute.OFFSET] = True
    received[:, Attribute.FEATURE] = _decode_features(context, predicted, symbols.feature, payloads)
    return DecodedParts(symbols, predicted.factors, received)


def _decode_features(
    context: CodingContext, predicted: Predictions, feature: np.ndarray, payloads: Mapping[int, bytes]
) -> bool:
    """Reads feature groups up to the first one that is missing; says whether none is."""
    edges, rows = _edges(context), slice(0, len(feature))
    for group, shared in enumerate(context.shared_sums(predicted.outputs)):
        if FIRST_FEATURE + group not in payloads:
            return False
        columns = slice(int(edges[group]), int(edges[group + 1]))
        before = context.feature_activations(feature[:, : columns.start], predicted.factors[:, 0])
        parts = predict_group(context, group, shared, before, predicted.outputs)
        values = decode_symbols(payloads[FIRST_FEATURE + group], _features(predicted, rows, columns, *parts))
        feature[:, columns] = values.reshape(len(feature), -1)
    return True


def _edges(context: CodingContext) -> np.ndarray:
    return np.cumsum([0, *context.config.layout.feature_groups])


def _normals(pair: tuple[np.ndarray, np.ndarray], rows: slice, keep: np.ndarray | None = None) -> Mixtures:
    """Distributions of scalings or offsets, anchor by anchor."""
    mean, scale = (values[rows] if keep is None else values[rows][keep] for values in pair)
    return Mixtures.normals(mean.ravel(), scale.ravel())


def _features(
    predicted: Predictions, rows: slice, columns: slice, mean: np.ndarray, scale: np.ndarray, weight: np.ndarray
) -> Mixtures:
    """Distributions of a feature group, anchor by anchor."""
    first = (values[rows, columns] for values in predicted.feature)
    parts = (*first, mean, scale, weight_table()[weight])
    return Mixtures(*(part.astype(np.int64).ravel() for part in parts))
