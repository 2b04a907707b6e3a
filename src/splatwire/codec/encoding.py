"""Scene to stream, whatever schema its anchors are coded with."""

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Int64, UInt8
from torch import Tensor

from splatwire.codec.background import background_sections
from splatwire.codec.geometry import anchor_order
from splatwire.codec.schema import AnchorEncoder, CodedPackets, chunks, update_digest
from splatwire.codec.schemas.causal.encoder import causal_encoder
from splatwire.codec.schemas.hacpp.encoder import hacpp_encoder
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tier_sizes import encode_tier_sizes
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers
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
    causal = isinstance(scene.coding, CausalCoding)
    make = causal_encoder if causal else hacpp_encoder
    encoder, side_info = make(scene, packetization, sections, noise)
    packets, digest = _encode_packets(encoder, plan, tier_of, threads, progress)
    stated = {} if causal else vars(scene.coding.config.layout)
    return make_stream(
        packetization=packetization, num_anchors=plan.num_anchors, side_info=side_info, packets=packets,
        symbols_digest=digest, writer=f"splatwire {__version__}", tiers=plan.tiers,
        codec=CAUSAL if causal else ANCHORS, **stated,
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
