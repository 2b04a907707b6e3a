"""Stream to scene: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.codec.atomic import Symbols, chunks, decode_packets
from splatwire.codec.coding_params import CodingContext, dequantise, factor_table, prior_columns, step_indices
from splatwire.codec.digest import update_digest
from splatwire.codec.fixed_point import ACTIVATION_BITS, FACTOR_BITS, OUTPUT_BITS
from splatwire.codec.side_info import SideInfo, read_side_info
from splatwire.codec.threads import ordered_map
from splatwire.codec.weights import QuantisedMlp
from splatwire.errors import BitstreamError, DesyncError, MissingSideInfoError
from splatwire.model import (
    AnchorScene,
    AttributePrior,
    ContextModel,
    GaussianHeads,
    HashGrid,
    Linear,
    Mlp,
    PartialScene,
    Prior,
)
from splatwire.model.prior_field import MIN_SCALE
from splatwire.packets import SceneStream, arrange
from splatwire.scene import Anchors, Erasures


def decode_stream(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> PartialScene:
    """Decodes what arrived of a stream.

    Args:
        stream: The stream; packets may be missing, side information may not.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The scene with anchors by rank; attributes that were not received are zero. The prior is that of every anchor.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the stream contradicts itself.
        DesyncError: If nothing was lost and yet the decoded integers are not those that were encoded.
    """
    manifest = stream.manifest
    if not stream.side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    if manifest.packetization.packaging != "atomic":
        raise BitstreamError(f"packaging '{manifest.packetization.packaging}' is not implemented by the decoder")
    info = read_side_info(stream.side_info, manifest.num_anchors, manifest.packetization.order)
    layout = info.config.layout
    stated = (manifest.feature_dim, manifest.num_offsets, manifest.feature_groups)
    if stated != (layout.feature_dim, layout.num_offsets, layout.feature_groups):
        raise BitstreamError(f"manifest and side information disagree on the layout of an anchor: {stated}, {layout}")
    arrays, digest = _decode_arrays(info, stream, threads, progress)
    if len(stream.packets) == manifest.num_packets and digest != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return _assemble(info, arrays)


@dataclass(frozen=True, eq=False)
class _Arrays:
    """Attributes and prior of all anchors by rank, filled chunk by chunk."""

    received: np.ndarray
    mask: np.ndarray
    values: tuple[np.ndarray, np.ndarray, np.ndarray]
    outputs: np.ndarray
    context: np.ndarray

    @staticmethod
    def empty(info: SideInfo) -> "_Arrays":
        num, layout, config = len(info.voxels), info.config.layout, info.config
        widths = (layout.feature_dim, 6, 3 * layout.num_offsets)
        return _Arrays(
            np.zeros(num, dtype=np.bool_),
            np.zeros((num, layout.num_offsets), dtype=np.bool_),
            (
                np.zeros((num, widths[0]), dtype=np.float32),
                np.zeros((num, widths[1]), dtype=np.float32),
                np.zeros((num, widths[2]), dtype=np.float32),
            ),
            np.empty((num, config.prior_dim), dtype=np.int32),
            np.empty((num, config.grid.context_dim), dtype=np.float32),
        )


def _decode_arrays(
    info: SideInfo, stream: SceneStream, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[_Arrays, str]:
    groups, packets = arrange(stream.manifest.plan, stream.packets)
    arrays, context, models = _Arrays.empty(info), info.coding_context(), info.mask_models()
    counts, digest = np.diff(groups.starts), hashlib.sha256()

    def decode_run(run: slice) -> tuple[slice, Symbols | None]:
        ranks = groups.ranks[groups.starts[run.start] : groups.starts[run.stop]]
        features, outputs = context.predict(info.voxels[ranks])
        arrays.outputs[ranks], arrays.context[ranks] = outputs, features
        here = packets[run]
        there = np.array([packet is not None for packet in here])
        if not there.any():
            return run, None
        of_anchor = np.repeat(there, counts[run])
        payloads = [packet.payload for packet in here if packet is not None]
        symbols, factors = decode_packets(context, outputs[of_anchor], counts[run][there], payloads, models)
        _store(arrays, ranks[of_anchor], symbols, factors, context)
        return run, symbols

    for run, symbols in ordered_map(decode_run, chunks(counts), threads):
        if symbols is not None:
            update_digest(digest, symbols)
        if progress:
            progress(run.stop / len(counts))
    return arrays, digest.hexdigest()


def _store(arrays: _Arrays, ranks: np.ndarray, symbols: Symbols, factors: np.ndarray, context: CodingContext) -> None:
    arrays.received[ranks] = True
    arrays.mask[ranks] = symbols.mask
    coded = (symbols.feature, symbols.scaling, symbols.offset)
    for a, (values, part) in enumerate(zip(arrays.values, coded, strict=True)):
        values[ranks] = dequantise(part, factors[:, a], context.config.base_steps[a])


def _assemble(info: SideInfo, arrays: _Arrays) -> PartialScene:
    num, layout = len(info.voxels), info.config.layout
    positions = (info.voxels.astype(np.float64) * info.voxel_size).astype(np.float32)
    features, scalings, offsets = (torch.from_numpy(v) for v in arrays.values)
    anchors = Anchors(
        torch.from_numpy(positions), features, scalings,
        offsets.reshape(num, layout.num_offsets, 3), torch.from_numpy(arrays.mask),
    )  # fmt: skip
    heads = GaussianHeads(*(_network(head) for head in info.heads))
    model = ContextModel(_grid(info), _network(info.prior), tuple(_network(mlp) for mlp in info.channel))
    scene = AnchorScene(anchors, heads, model, info.voxel_size, info.config)
    return PartialScene(scene, Erasures.of_anchors(torch.from_numpy(arrays.received)), _prior(info, arrays))


def _prior(info: SideInfo, arrays: _Arrays) -> Prior:
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


def _network(mlp: QuantisedMlp) -> Mlp:
    layers = [Linear(*(torch.from_numpy(a) for a in layer.dequantised())) for layer in (mlp.hidden, mlp.output)]
    return Mlp(layers[0], layers[1], 0.01 if mlp.leaky else 0.0)


def _grid(info: SideInfo) -> HashGrid:
    rows = sum(info.config.grid.rows(3))
    return HashGrid(
        torch.from_numpy(info.signs[:rows].copy()),
        torch.from_numpy(info.signs[rows:].reshape(3, -1, info.signs.shape[1]).copy()),
        torch.from_numpy(info.bounds_min),
        torch.from_numpy(info.bounds_max),
    )
