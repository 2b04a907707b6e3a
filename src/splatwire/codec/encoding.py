"""Scene to stream, whatever schema its anchors are coded with."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Int64, UInt8
from torch import Tensor

from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.codec.background import background_sections
from splatwire.codec.decoding import decode_anchors
from splatwire.codec.geometry import anchor_order
from splatwire.codec.schema import AnchorEncoder, CodedPackets, chunks, update_digest
from splatwire.codec.schemas.causal.encoder import causal_encoder, causal_encoder_again
from splatwire.codec.schemas.hacpp.encoder import hacpp_encoder, hacpp_encoder_again
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tier_sizes import encode_tier_sizes
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers, read_tiers
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, CausalCoding
from splatwire.model.voxels import voxel_indices
from splatwire.packets import (
    ANCHORS,
    CAUSAL,
    HEADER_BYTES,
    Packet,
    PacketId,
    Packetization,
    PacketPlan,
    SceneStream,
    make_packet,
    make_stream,
    shape_tiers,
    spread_packetization,
    tier_order,
)
from splatwire.packets.sections import sections_of
from splatwire.version import __version__


def encode_anchors(
    scene: AnchorScene,
    packetization: Packetization | None = None,
    *,
    tiers: UInt8[Tensor, "N"] | None = None,
    noise: float | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """Encodes a scene of anchors; see `splatwire.codec.encode_scene`.

    Args:
        scene: The scene; its render hints are not coded.
        packetization: How anchors are split; None for `spread_packetization`.
        tiers: Tier of each of the scene's anchors, 0 for the most important (`Importance.tiers`): each tier gets
            packets of its own, so that it can be protected on its own. None for one tier. Decoded values stay the same.
        noise: Tolerated noise of the context networks (see the schema's `fit`); None for the measured rule.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite or too large, a tier is empty, or
            the packetization is not for this model.
    """
    index = coding_order(scene, "morton" if packetization is None else packetization.order)
    packetization = packetization or spread_packetization(len(index))
    scene, tier_of = _select(scene, index), _tiers(tiers, scene, index)
    plan = _plan(scene, packetization, tier_of)
    sections = background_sections(scene.background)
    if plan.tiers:
        sections[TIERS] = encode_tiers(tier_of, len(plan.tiers))
        sections[TIER_SIZES] = encode_tier_sizes(scene.anchors, tier_of, len(plan.tiers))
    encoder, side_info = _schema_of(scene).first(scene, packetization, sections, noise)
    return _stream(scene, encoder, side_info, plan, tier_of, threads, progress)


def repack_anchors(
    stream: SceneStream,
    packetization: Packetization,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """The same integers under the same side information in other packets; see `splatwire.codec.repack`."""
    manifest = stream.manifest
    scene = decode_anchors(stream, threads=threads).scene
    sections = sections_of(stream)
    tier_of = read_tiers(sections, manifest)
    if packetization.order != manifest.packetization.order:
        if kept := sorted(set(sections) - {BACKGROUND, MASKS}):
            raise InvalidValueError(
                f"'{kept[0]}' of this stream is for anchors in {manifest.packetization.order} order"
            )
        scene = scene_in_order(scene, packetization.order)
    plan = _plan(scene, packetization, tier_of)
    encoder, side_info = _schema_of(scene).again(scene, packetization, stream.side_info)
    return _stream(scene, encoder, side_info, plan, tier_of, threads, progress)


@dataclass(frozen=True)
class _Schema:
    """How anchors are coded: the codec's name, what makes its encoders, and what the manifest says of an anchor."""

    codec: str
    first: Callable[..., tuple[AnchorEncoder, bytes]]
    again: Callable[..., tuple[AnchorEncoder, bytes]]
    stated: Mapping[str, Any]


def _schema_of(scene: AnchorScene) -> _Schema:
    if isinstance(scene.coding, CausalCoding):
        return _Schema(CAUSAL, causal_encoder, causal_encoder_again, {})
    return _Schema(ANCHORS, hacpp_encoder, hacpp_encoder_again, vars(scene.coding.config.layout))


def _stream(
    scene: AnchorScene,
    encoder: AnchorEncoder,
    side_info: bytes,
    plan: PacketPlan,
    tier_of: np.ndarray,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> SceneStream:
    packets, digest = _encode_packets(encoder, plan, tier_of, threads, progress)
    schema = _schema_of(scene)
    return make_stream(
        packetization=plan.packetization, num_anchors=plan.num_anchors, side_info=side_info, packets=packets,
        symbols_digest=digest, writer=f"splatwire {__version__}", tiers=plan.tiers,
        codec=schema.codec, **schema.stated,
    )  # fmt: skip


def _encode_packets(
    encoder: AnchorEncoder,
    plan: PacketPlan,
    tier_of: np.ndarray,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> tuple[list[Packet], str]:
    """All packets in the order of the plan, and the digest of what they hold."""
    packetization, groups, digest = plan.packetization, plan.groups(), hashlib.sha256()
    counts, rank_at = np.diff(groups.starts), tier_order(tier_of)[groups.ranks]
    most = packetization.packet_bytes - HEADER_BYTES if packetization.hashed else None

    def encode_run(run: slice) -> tuple[slice, CodedPackets]:
        ranks = rank_at[groups.starts[run.start] : groups.starts[run.stop]]
        return run, encoder.encode(ranks, counts[run], most)

    payloads: list[bytes] = []
    held: list[int] = []
    for run, coded in ordered_map(encode_run, chunks(counts), threads):
        payloads += coded.payloads
        held += coded.counts.tolist()
        update_digest(digest, coded.rows)
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
        The scene with the anchors that can be drawn, render hints left out.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    return _select(scene, coding_order(scene, order))


def coding_order(scene: AnchorScene, order: str) -> Int64[Tensor, "n"]:
    """Indices of the scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene, N anchors of which n can be drawn (`splatwire.scene.rows`).
        order: As in `Packetization.order`.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    drawable = scene.drawable.nonzero()[:, 0]
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
