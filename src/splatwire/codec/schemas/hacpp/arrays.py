"""Decoded attributes of anchors by rank, and the scene that they are."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.background import read_background
from splatwire.codec.fixed_point import ACTIVATION_BITS, FACTOR_BITS, OUTPUT_BITS
from splatwire.codec.heads import network_of
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schemas.hacpp.atomic import Symbols
from splatwire.codec.schemas.hacpp.coding_params import (
    CodingContext,
    dequantise,
    factor_table,
    prior_columns,
    step_indices,
)
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.codec.schemas.hacpp.side_info import SideInfo
from splatwire.model import (
    AnchorScene,
    AttributePrior,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    Partial,
    Prior,
)
from splatwire.model.prior import MIN_SCALE
from splatwire.scene import Anchors, Attribute, Erasures


@dataclass(frozen=True, eq=False)
class DecodedArrays:
    """Attributes and prior of N anchors by rank, filled packet by packet; zero where nothing was received.

    Attributes:
        received: bool (N, 4), one column per `Attribute`.
        mask: bool (N, K).
        values: Feature (N, F), scaling (N, 6) and offset (N, 3 K), float32.
        outputs: Prior outputs, int32 (N, prior outputs).
        context: Hash-grid feature, float32 (N, H), whole numbers with `ACTIVATION_BITS` fractional bits.
    """

    received: np.ndarray
    mask: np.ndarray
    values: tuple[np.ndarray, np.ndarray, np.ndarray]
    outputs: np.ndarray
    context: np.ndarray

    @staticmethod
    def empty(info: SideInfo) -> "DecodedArrays":
        """Arrays for a stream of which no packet has been decoded; prior and context hold nothing yet."""
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
    """Writes the attributes of some anchors.

    Args:
        arrays: Where to.
        ranks: The anchors, int64 (n).
        symbols: Their symbols.
        factors: Their step factors, int64 (n, 3).
        context: What they were decoded with.
        received: Which of their attributes arrived, bool (n, 4); True for all.
    """
    arrays.received[ranks] = received
    arrays.mask[ranks] = symbols.mask
    coded = (symbols.feature, symbols.scaling, symbols.offset)
    for a, (values, part) in enumerate(zip(arrays.values, coded, strict=True)):
        values[ranks] = dequantise(part, factors[:, a], context.config.base_steps[a])


def assemble_scene(info: SideInfo, arrays: DecodedArrays) -> Partial[AnchorScene]:
    """Makes a scene of arrays; its anchors share their memory.

    Args:
        info: The stream's side information.
        arrays: Filled as far as packets arrived, the prior for all anchors.
    """
    num, layout = len(info.voxels), info.config.layout
    positions = (info.voxels.astype(np.float64) * info.voxel_size).astype(np.float32)
    features, scalings, offsets = (v for v in arrays.values)
    anchors = Anchors(
        positions, features, scalings,
        offsets.reshape(num, layout.num_offsets, 3), arrays.mask,
    )  # fmt: skip
    heads = GaussianHeads(*(network_of(head) for head in info.heads))
    model = ContextModel(_grid(info), network_of(info.prior), tuple(network_of(mlp) for mlp in info.channel))
    background = read_background(info.sections)
    scene = AnchorScene(
        anchors,
        heads,
        HacppCoding(model, info.voxel_size, info.config),
        background=background,
        metadata=read_metadata(info.sections),
    )
    erasures = Erasures(arrays.received)
    return Partial(scene, erasures, concealer_sections(info.sections, MASKS), (_prior(info, arrays), layout))


def _prior(info: SideInfo, arrays: DecodedArrays) -> Prior:
    """The prior in floats: exactly the numbers that the coding path used."""
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
    return Prior(feature, scaling, offset, arrays.context * np.float32(2.0**-ACTIVATION_BITS))


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
