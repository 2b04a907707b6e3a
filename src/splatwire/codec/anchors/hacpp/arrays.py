"""Decoded attributes of anchors in coding order, and their conversion to a scene."""

from dataclasses import dataclass

import numpy as np

from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.anchors.hacpp.atomic import Symbols
from splatwire.codec.anchors.hacpp.coding_params import (
    CodingContext,
    dequantise,
    factor_table,
    prior_columns,
    step_indices,
)
from splatwire.codec.anchors.hacpp.separated import SECTION as MASKS
from splatwire.codec.anchors.hacpp.side_info import SideInfo
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.fixed_point import ACTIVATION_BITS, FACTOR_BITS, OUTPUT_BITS
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.quantised_networks import network_of
from splatwire.types import (
    Anchors,
    AnchorScene,
    Attribute,
    AttributePrior,
    GaussianHeads,
    HacppCoding,
    HacppContextModel,
    HashGrid,
    LossMask,
    Prior,
    ReceivedScene,
)
from splatwire.types.prior import MIN_SCALE


@dataclass(frozen=True, eq=False)
class DecodedArrays:
    """Arrays for the decoded attributes and the predictions of N anchors in coding order.

    The attributes of each packet are written to the arrays as the packet arrives. Missing attributes are 0.

    Attributes:
        received: Mask of received attributes, bool (N, 4), one column per `Attribute`.
        mask: Mask of the offsets that exist, bool (N, K).
        values: Feature (N, F), scaling (N, 6) and offset (N, 3 K), float32.
        outputs: Outputs of the prior network, int32 (N, outputs).
        context_features: Hash-grid features, float32 (N, H), with `ACTIVATION_BITS` fractional bits.
    """

    received: np.ndarray
    mask: np.ndarray
    values: tuple[np.ndarray, np.ndarray, np.ndarray]
    outputs: np.ndarray
    context_features: np.ndarray

    @staticmethod
    def empty(info: SideInfo) -> "DecodedArrays":
        """Allocates the arrays of a scene, before any packet is received.

        Masks and attributes are 0. Outputs of the prior network and hash-grid features are uninitialised.
        """
        # `outputs` and `context_features` are uninitialised.
        num, layout, config = len(info.voxels), info.config.layout, info.config
        widths = (layout.feature_dim, 6, 3 * layout.num_offsets)
        return DecodedArrays(
            np.zeros((num, len(Attribute)), dtype=np.bool_),
            np.zeros((num, layout.num_offsets), dtype=np.bool_),
            (
                np.zeros((num, widths[0]), dtype=np.float32),
                np.zeros((num, widths[1]), dtype=np.float32),
                np.zeros((num, widths[2]), dtype=np.float32),
            ),
            np.empty((num, config.prior_dim), dtype=np.int32),
            np.empty((num, config.grid.context_dim), dtype=np.float32),
        )


def store_symbols(
    arrays: DecodedArrays,
    ranks: np.ndarray,
    symbols: Symbols,
    factors: np.ndarray,
    context: CodingContext,
    received: np.ndarray | bool = True,
) -> None:
    """Dequantises the attributes of decoded anchors, and writes them to the arrays of the scene.

    Args:
        arrays: Destination.
        ranks: Indices of the n anchors in coding order, int64 (n).
        symbols: Quantised attributes of the anchors.
        factors: Factors by which the base quantisation steps of feature, scaling and offset are multiplied, in fixed
            point with `FACTOR_BITS` fractional bits, int64 (n, 3).
        context: The stream's networks and constants.
        received: Mask of received attributes, bool (n, 4); True for all.
    """
    arrays.received[ranks] = received
    arrays.mask[ranks] = symbols.mask
    coded = (symbols.feature, symbols.scaling, symbols.offset)
    for a, (values, part) in enumerate(zip(arrays.values, coded, strict=True)):
        values[ranks] = dequantise(part, factors[:, a], context.config.base_steps[a])


def assemble_scene(info: SideInfo, arrays: DecodedArrays) -> ReceivedScene[AnchorScene]:
    """Builds a scene from decoded attributes; features, scalings, offsets and masks share memory with `arrays`.

    Args:
        info: The stream's side information.
        arrays: Decoded attributes, and the predictions of all anchors.
    """
    num, layout = len(info.voxels), info.config.layout
    positions = (info.voxels.astype(np.float64) * info.voxel_size).astype(np.float32)
    features, scalings, offsets = (v for v in arrays.values)
    anchors = Anchors(
        positions, features, scalings,
        offsets.reshape(num, layout.num_offsets, 3), arrays.mask,
    )  # fmt: skip
    heads = GaussianHeads(*(network_of(head) for head in info.heads))
    model = HacppContextModel(_grid(info), network_of(info.prior), tuple(network_of(mlp) for mlp in info.channel))
    background = BACKGROUND_SECTION.read(info.sections)
    scene = AnchorScene(
        anchors,
        heads,
        HacppCoding(model, info.voxel_size, info.config),
        background=background,
        origin=ORIGIN_SECTION.read(info.sections),
        metadata=read_metadata(info.sections),
    )
    loss_mask = LossMask(arrays.received)
    return ReceivedScene(
        scene, loss_mask, concealer_sections(info.sections, MASKS), (_float_prior(info, arrays), layout)
    )


def _float_prior(info: SideInfo, arrays: DecodedArrays) -> Prior:
    """Converts the predicted distributions of all anchors from fixed point to floats."""
    columns, layout = prior_columns(info.config), info.config.layout
    factors = factor_table()[step_indices(arrays.outputs, info.config)]
    spans = (
        (columns.feature_mean, columns.feature_scale, layout.feature_dim),
        (columns.scaling_mean, columns.scaling_scale, 6),
        (columns.offset_mean, columns.offset_scale, 3 * layout.num_offsets),
    )
    attributes = []
    for a, (mean, scale, width) in enumerate(spans):
        step = factors[:, a : a + 1].astype(np.float64) * (info.config.base_steps[a] / (1 << FACTOR_BITS))
        attributes.append(
            AttributePrior(
                _to_float(arrays.outputs[:, mean : mean + width]),
                np.maximum(_to_float(arrays.outputs[:, scale : scale + width]), np.float32(MIN_SCALE)),
                step.astype(np.float32),
            )
        )
    feature, scaling, offset = attributes
    return Prior(feature, scaling, offset, arrays.context_features * np.float32(2.0**-ACTIVATION_BITS))


def _to_float(outputs: np.ndarray) -> np.ndarray:
    return outputs.astype(np.float32) * np.float32(2.0**-OUTPUT_BITS)


def _grid(info: SideInfo) -> HashGrid:
    rows = sum(info.config.grid.rows(3))
    return HashGrid(
        info.signs[:rows].copy(),
        info.signs[rows:].reshape(3, -1, info.signs.shape[1]).copy(),
        info.bounds_min,
        info.bounds_max,
    )
