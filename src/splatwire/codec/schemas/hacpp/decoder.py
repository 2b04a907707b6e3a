"""From packets of schema `hacpp` to attributes: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.codec.background import read_background
from splatwire.codec.fixed_point import ACTIVATION_BITS, FACTOR_BITS, OUTPUT_BITS
from splatwire.codec.heads import network_of
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schema import update_digest
from splatwire.codec.schemas.hacpp.atomic import Symbols, decode_packets
from splatwire.codec.schemas.hacpp.coding_params import (
    CodingContext,
    dequantise,
    factor_table,
    prior_columns,
    step_indices,
)
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.codec.schemas.hacpp.separated import decode_masks, decode_parts
from splatwire.codec.schemas.hacpp.side_info import SideInfo, read_side_info
from splatwire.codec.threads import ordered_map
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.model import (
    AnchorScene,
    AttributePrior,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    PartialScene,
    Prior,
)
from splatwire.model.prior_field import MIN_SCALE
from splatwire.packets import Manifest, SceneStream, arrange
from splatwire.scene import Anchors, Attribute, Erasures


def open_side_info(manifest: Manifest, side_info: bytes) -> SideInfo:
    """Reads the side information of a stream and compares it with the manifest.

    Args:
        manifest: The stream's manifest.
        side_info: The bytes.

    Raises:
        MissingSideInfoError: If there are none.
        BitstreamError: If they are damaged or contradict the manifest.
    """
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    info = read_side_info(side_info, manifest.num_anchors, manifest.packetization.order)
    layout = info.config.layout
    stated = (manifest.feature_dim, manifest.num_offsets, manifest.feature_groups)
    if stated != (layout.feature_dim, layout.num_offsets, layout.feature_groups):
        raise BitstreamError(f"manifest and side information disagree on the layout of an anchor: {stated}, {layout}")
    return info


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


class HacppDecoder:
    """See `AnchorDecoder`.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged or contradicts the manifest.
    """

    def __init__(self, manifest: Manifest, side_info: bytes) -> None:
        self._info = open_side_info(manifest, side_info)
        self._arrays, self._models = DecodedArrays.empty(self._info), self._info.mask_models()
        self._context, self._layout = self._info.coding_context(), self._info.config.layout
        self.sections = self._info.sections
        self.num_symbols = self._layout.feature_dim + 6 + 4 * self._layout.num_offsets

    def predict(self, ranks: np.ndarray) -> None:
        """See `AnchorDecoder.predict`."""
        features, outputs = self._context.predict(self._info.voxels[ranks])
        self._arrays.outputs[ranks], self._arrays.context[ranks] = outputs, features

    def decode(self, ranks: np.ndarray, counts: np.ndarray, payloads: Sequence[bytes]) -> np.ndarray:
        """See `AnchorDecoder.decode`."""
        outputs = self._arrays.outputs[ranks]
        return decode_packets(self._context, outputs, counts, list(payloads), self._models)[0].rows()

    def store(self, ranks: np.ndarray, rows: np.ndarray) -> None:
        """See `AnchorDecoder.store`."""
        factors = factor_table()[step_indices(self._arrays.outputs[ranks], self._info.config)]
        store_symbols(self._arrays, ranks, Symbols.of_rows(rows, self._layout), factors, self._context)

    def scene(self) -> PartialScene:
        """See `AnchorDecoder.scene`."""
        return assemble_scene(self._info, self._arrays)


def decode_separated(
    stream: SceneStream, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[PartialScene, str]:
    """Decodes separated attributes, each group of anchors as far as its parts arrived.

    Returns:
        The scene, and the digest of all integers. Of a feature that arrived in part, the channels before the first
        missing group are there, though it counts as not received.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged or contradicts the manifest.
    """
    info = open_side_info(stream.manifest, stream.side_info)
    plan, context, masks = stream.manifest.plan, info.coding_context(), decode_masks(info)
    groups, packets = arrange(plan, stream.packets)
    arrays, digest, num_parts = DecodedArrays.empty(info), hashlib.sha256(), len(plan.parts)
    num_groups = len(groups.starts) - 1

    def decode_group(group: int) -> tuple[int, Symbols]:
        ranks = groups.ranks[groups.starts[group] : groups.starts[group + 1]]
        features, outputs = context.predict(info.voxels[ranks])
        arrays.outputs[ranks], arrays.context[ranks] = outputs, features
        here = packets[group * num_parts : (group + 1) * num_parts]
        payloads = {packet.id.part: packet.payload for packet in here if packet is not None}
        decoded = decode_parts(context, outputs, masks[ranks], payloads)
        store_symbols(arrays, ranks, decoded.symbols, decoded.factors, context, decoded.received)
        return group, decoded.symbols

    for group, symbols in ordered_map(decode_group, range(num_groups), threads):
        update_digest(digest, symbols.rows())
        if progress:
            progress((group + 1) / num_groups)
    return assemble_scene(info, arrays), digest.hexdigest()


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


def assemble_scene(info: SideInfo, arrays: DecodedArrays) -> PartialScene:
    """Makes a scene of arrays; its anchors share their memory.

    Args:
        info: The stream's side information.
        arrays: Filled as far as packets arrived, the prior for all anchors.
    """
    num, layout = len(info.voxels), info.config.layout
    positions = (info.voxels.astype(np.float64) * info.voxel_size).astype(np.float32)
    features, scalings, offsets = (torch.from_numpy(v) for v in arrays.values)
    anchors = Anchors(
        torch.from_numpy(positions), features, scalings,
        offsets.reshape(num, layout.num_offsets, 3), torch.from_numpy(arrays.mask),
    )  # fmt: skip
    heads = GaussianHeads(*(network_of(head) for head in info.heads))
    model = ContextModel(_grid(info), network_of(info.prior), tuple(network_of(mlp) for mlp in info.channel))
    background = read_background(info.sections)
    scene = AnchorScene(anchors, heads, HacppCoding(model, info.voxel_size, info.config), background=background)
    erasures = Erasures(torch.from_numpy(arrays.received))
    return PartialScene(scene, erasures, _prior(info, arrays), concealer_sections(info.sections, MASKS))


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
                _to_float(arrays.outputs[:, scale : scale + width]).clamp(min=MIN_SCALE),
                torch.from_numpy(step.astype(np.float32)),
            )
        )
    feature, scaling, offset = attributes
    return Prior(feature, scaling, offset, torch.from_numpy(arrays.context).mul_(2.0**-ACTIVATION_BITS))


def _to_float(outputs: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(outputs).float().mul_(2.0**-OUTPUT_BITS)


def _grid(info: SideInfo) -> HashGrid:
    rows = sum(info.config.grid.rows(3))
    return HashGrid(
        torch.from_numpy(info.signs[:rows].copy()),
        torch.from_numpy(info.signs[rows:].reshape(3, -1, info.signs.shape[1]).copy()),
        torch.from_numpy(info.bounds_min),
        torch.from_numpy(info.bounds_max),
    )
