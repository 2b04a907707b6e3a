"""Scene to stream."""

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Int64, UInt8
from torch import Tensor

from splatwire.codec.background import background_sections
from splatwire.codec.geometry import anchor_order
from splatwire.codec.schemas.hacpp.atomic import (
    Symbols,
    chunks,
    cut_packets,
    encode_packets,
    predict_mixture,
    predict_packets,
)
from splatwire.codec.schemas.hacpp.coding_params import CodingContext, quantise
from splatwire.codec.schemas.hacpp.digest import update_digest
from splatwire.codec.schemas.hacpp.fit import fit_side_info
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.codec.schemas.hacpp.separated import encode_masks, encode_parts
from splatwire.codec.schemas.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.codec.threads import ordered_map
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model import AnchorScene
from splatwire.model.voxels import voxel_indices
from splatwire.packets import (
    HEADER_BYTES,
    PRESETS,
    Packet,
    PacketId,
    Packetization,
    PacketPlan,
    SceneStream,
    make_packet,
    make_stream,
    shape_tiers,
    tier_order,
)
from splatwire.version import __version__

MAX_SYMBOL = (1 << 31) - 1


def encode_scene(
    scene: AnchorScene,
    packetization: Packetization | None = None,
    *,
    tiers: UInt8[Tensor, "N"] | None = None,
    noise: float | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """Encodes a scene into independently decodable packets (paper 3.2).

    Anchors without a single existing offset draw nothing and are not coded, as in HAC++ (HACPP_SPEC 2).

    Args:
        scene: The scene; its render hints are not coded.
        packetization: How anchors are split; None for preset `paper`.
        tiers: Tier of each of the scene's anchors, 0 for the most important (`Importance.tiers`): each tier gets
            packets of its own, so that it can be protected on its own. None for one tier. Decoded values stay the same.
        noise: Tolerated noise of the context networks (see `fit`); None for the measured rule.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite or too large, a tier is empty, or
            `scene` is none.
    """
    check_kind(scene, AnchorScene, "load_scene")
    packetization = packetization or PRESETS["paper"]
    index = coding_order(scene, packetization.order)
    scene, tier_of = _select(scene, index), _tiers(tiers, scene, index)
    source = SymbolSource(scene)
    plan = _plan(scene, packetization, tier_of)
    side_info = write_side_info(_side_info(scene, plan, tier_of, noise))
    # Predict from what a decoder will read, not from what was meant.
    info = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    packets, digest = _encode_packets(source, plan, info, tier_of, threads, progress)
    layout = scene.coding.config.layout
    return make_stream(
        packetization=packetization, num_anchors=plan.num_anchors, feature_dim=layout.feature_dim,
        num_offsets=layout.num_offsets, feature_groups=layout.feature_groups, side_info=side_info, packets=packets,
        symbols_digest=digest, writer=f"splatwire {__version__}", tiers=plan.tiers,
    )  # fmt: skip


def _encode_packets(
    source: "SymbolSource",
    plan: PacketPlan,
    info: SideInfo,
    tier_of: np.ndarray,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> tuple[list[Packet], str]:
    """All packets in the order of the plan, and the digest of what they hold."""
    packetization, context, groups, digest = plan.packetization, info.coding_context(), plan.groups(), hashlib.sha256()
    counts, rank_at = np.diff(groups.starts), tier_order(tier_of)[groups.ranks]

    def encode_run(run: slice) -> tuple[slice, np.ndarray, list[bytes], Symbols]:
        ranks = rank_at[groups.starts[run.start] : groups.starts[run.stop]]
        predicted = predict_packets(context, context.predict(info.voxels[ranks])[1])
        symbols = source.symbols(ranks, predicted.factors, context)
        mixture, models, sizes = predict_mixture(context, predicted, symbols.feature), info.mask_models(), counts[run]
        if packetization.separated:
            coded = encode_parts(context, predicted, mixture, sizes, symbols)
            return run, np.repeat(sizes, len(plan.parts)), coded, symbols
        if packetization.hashed:
            most = packetization.packet_bytes - HEADER_BYTES
            sizes = cut_packets(predicted, mixture, sizes, symbols, models, most)
        return run, sizes, encode_packets(context, predicted, sizes, symbols, models, mixture), symbols

    payloads: list[bytes] = []
    held: list[int] = []
    for run, sizes, coded, symbols in ordered_map(encode_run, chunks(counts), threads):
        payloads += coded
        held += sizes.tolist()
        update_digest(digest, symbols)
        if progress:
            progress(run.stop / len(counts))
    ids = _hashed_ids(plan, held) if packetization.hashed else plan.ids
    packets = [make_packet(i, n, p) for i, n, p in zip(ids, held, payloads, strict=True)]
    _check_sizes(packetization, packets)
    return packets, digest.hexdigest()


def _hashed_ids(plan: PacketPlan, counts: list[int]) -> list[PacketId]:
    """Names of packets that were cut by their size: each by the first rank that it holds."""
    return [plan.name_hashed(first) for first in np.cumsum([0, *counts[:-1]]).tolist()]


def _check_sizes(packetization: Packetization, packets: list[Packet]) -> None:
    """Refuses an anchor that alone is larger than a packet may be."""
    for packet in packets:
        if packetization.hashed and packet.num_bytes > packetization.packet_bytes:
            raise InvalidValueError(
                f"{packet.num_anchors} anchor of this scene takes {packet.num_bytes} bytes, "
                f"a packet holds {packetization.packet_bytes}: choose a larger packet size or another preset"
            )


def scene_in_order(scene: AnchorScene, order: str) -> AnchorScene:
    """The scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene.
        order: As in `Packetization.order`.

    Returns:
        The scene with the anchors that have at least one offset, render hints left out.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    return _select(scene, coding_order(scene, order))


def coding_order(scene: AnchorScene, order: str) -> Int64[Tensor, "n"]:
    """Indices of the scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene, N anchors of which n have at least one offset.
        order: As in `Packetization.order`.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    drawable = scene.anchors.mask.any(dim=1).nonzero()[:, 0]
    if not len(drawable):
        raise InvalidValueError("the scene has no anchor that draws anything: there is nothing to encode")
    voxels = voxel_indices(scene.anchors.positions[drawable], scene.coding.voxel_size)
    return drawable[drawable.new_tensor(anchor_order(voxels.numpy(), order))]


def _select(scene: AnchorScene, index: Int64[Tensor, "n"]) -> AnchorScene:
    return replace(scene, anchors=scene.anchors.select(index), hints=None)


def _tiers(tiers: UInt8[Tensor, "N"] | None, scene: AnchorScene, index: Int64[Tensor, "n"]) -> np.ndarray:
    """Tier of each coded anchor, by rank."""
    if tiers is None:
        return np.zeros(len(index), dtype=np.uint8)
    if len(tiers) != scene.anchors.num_anchors:
        raise InvalidValueError(f"{len(tiers)} tiers for a scene of {scene.anchors.num_anchors} anchors")
    return tiers[index].numpy()


def _plan(scene: AnchorScene, packetization: Packetization, tier_of: np.ndarray) -> PacketPlan:
    groups = len(scene.coding.config.layout.feature_groups) if packetization.separated else 0
    return PacketPlan(packetization, scene.anchors.num_anchors, shape_tiers(tier_of, packetization), groups)


def _side_info(scene: AnchorScene, plan: PacketPlan, tier_of: np.ndarray, noise: float | None) -> SideInfo:
    """Side information of a scene whose anchors are sorted by rank."""
    info, sections = fit_side_info(scene, _voxels(scene), noise=noise), background_sections(scene.background)
    if plan.tiers:
        sections[TIERS] = encode_tiers(tier_of, len(plan.tiers))
    if plan.packetization.separated:
        sections[MASKS] = encode_masks(scene.anchors.mask.numpy(), info.mask_models())
    return replace(info, sections=sections)


class SymbolSource:
    """Quantises a scene's attributes with the steps that the coding context gives.

    Args:
        scene: The scene, anchors by rank.
    """

    def __init__(self, scene: AnchorScene) -> None:
        anchors = scene.anchors
        self._mask = anchors.mask.numpy()
        self._values = (
            anchors.features.numpy(),
            anchors.scalings.numpy(),
            (anchors.offsets * anchors.mask[:, :, None]).flatten(1).numpy(),
        )
        for name, values in zip(("features", "scalings", "offsets"), self._values, strict=True):
            if not np.isfinite(values).all():
                raise InvalidValueError(f"the scene's {name} are not all finite")

    def symbols(self, ranks: np.ndarray, factors: np.ndarray, context: CodingContext) -> Symbols:
        """Symbols of the anchors at `ranks` under step factors int64 (n, 3)."""
        parts = []
        for a, values in enumerate(self._values):
            base = context.config.base_steps[a]
            if np.abs(values[ranks]).max(initial=0) / (base * factors[:, a].min() / 65536) > MAX_SYMBOL:
                raise InvalidValueError("an attribute is too large for its quantisation step")
            parts.append(quantise(values[ranks], factors[:, a], base))
        return Symbols(self._mask[ranks].astype(np.uint8), *parts)


def _voxels(scene: AnchorScene) -> np.ndarray:
    return voxel_indices(scene.anchors.positions, scene.coding.voxel_size).numpy()
