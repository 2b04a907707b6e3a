"""From a scene's anchors to packets of schema `causal`."""

from dataclasses import replace

import numpy as np

from splatwire.codec.schema import CodedPackets
from splatwire.codec.schemas.causal.context import CodingContext
from splatwire.codec.schemas.causal.packet_coder import Quantised, anchor_bits, cut_packets, encode_packets, quantise
from splatwire.codec.schemas.causal.places import SharedPlaces, share_places
from splatwire.codec.schemas.causal.side_info import LOG_BITS, SideInfo, read_side_info, write_side_info
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene
from splatwire.model.voxels import voxel_indices
from splatwire.ops.morton import morton_encode
from splatwire.packets import Packetization
from splatwire.scene import Anchors

_LOGS = [0, 3, 4, 5]
"""Which of an anchor's six scalings its four logarithms are of."""
HEAD_SHARE = 0.08
"""Side information is kept below this share of the stream by leaving more of the places to packets, within limits."""
MOST_LEAF = 8
SAMPLE_SEED = 0
SAMPLE = 1000
MAX_NUMBER = 14_000
"""Numbers of anchors are within this many steps, so that they and their means fit into 32 bits."""


def causal_encoder(
    scene: AnchorScene, packetization: Packetization, sections: dict[str, bytes], noise: float | None
) -> tuple["CausalEncoder", bytes]:
    """Quantises what all packets share; returns what codes the anchors, and the side information.

    Args:
        scene: The scene, anchors by rank.
        packetization: How they are split.
        sections: Named sections of the side information.
        noise: Tolerated noise of the context networks; None for the measured rule.

    Raises:
        InvalidValueError: If attributes would be packets of their own, or the scene is not one for the format.
    """
    _check_common(packetization)
    scene = replace(scene, anchors=_with_sizes(scene.anchors))
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    from splatwire.codec.schemas.causal.fit import fit_side_info  # needs torch

    info = fit_side_info(scene, voxels, noise=noise)
    places = _balanced(info, voxels, CausalEncoder(scene, info, voxels).expected_bytes())
    side_info = write_side_info(replace(info, places=places, sections=sections))
    # Predict from what a decoder will read, not from what was meant.
    info = read_side_info(side_info, scene.anchors.num_anchors)
    return CausalEncoder(scene, info, voxels), side_info


def causal_encoder_again(
    scene: AnchorScene, packetization: Packetization, side_info: bytes
) -> tuple["CausalEncoder", bytes]:
    """What codes the anchors of a decoded scene with the side information that it was decoded with, and that.

    Raises:
        InvalidValueError: If attributes would be packets of their own.
        BitstreamError: If the side information is damaged.
    """
    _check_common(packetization)
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    return CausalEncoder(scene, read_side_info(side_info, scene.anchors.num_anchors), voxels), side_info


def _check_common(packetization: Packetization) -> None:
    if not packetization.common:
        raise InvalidValueError(
            "anchors of the causal model are coded whole and in Morton order: preset 'hacpp' is for those of HAC++"
        )


def _balanced(info: SideInfo, voxels: np.ndarray, packet_bytes: float) -> SharedPlaces:
    """How places are divided between side information and packets: as little to packets as `HEAD_SHARE` allows.

    Args:
        info: Side information with nearly all of the places.
        voxels: int64 (N, 3).
        packet_bytes: Expected bytes of all packets.
    """
    places, others = info.places, len(write_side_info(info)) - len(info.places.section)
    most = HEAD_SHARE * (others + len(places.section) + packet_bytes) - others
    for leaf in range(2, MOST_LEAF + 1):
        if len(places.section) <= most:
            break
        places = share_places(voxels, leaf)
    return places


def _with_sizes(anchors: Anchors) -> Anchors:
    """The anchors, scalings of 0, which have no logarithm, as small as the smallest of the others."""
    there = anchors.scalings > 0
    if bool(there.all()):
        return anchors
    if not bool(there.any()):
        raise InvalidValueError("no scaling of the scene's anchors is positive")
    return replace(anchors, scalings=np.maximum(anchors.scalings, anchors.scalings[there].min()))


class CausalEncoder:
    """See `AnchorCoder`.

    Args:
        scene: The scene, anchors by rank.
        info: Its side information.
        voxels: int64 (N, 3), where its anchors are.

    Raises:
        InvalidValueError: If an attribute is too large for its step.
    """

    def __init__(self, scene: AnchorScene, info: SideInfo, voxels: np.ndarray) -> None:
        anchors, groups, known = scene.anchors, info.config.layout.feature_groups, info.places.known
        self._context = CodingContext.of(info)
        self._places = replace(known, codes=morton_encode(voxels - known.origin))
        self._octaves = float(info.log_steps[0]) * 2.0**-LOG_BITS
        self._masks = anchors.mask.astype(np.uint8)
        logs = np.log2(anchors.scalings.astype(np.float64)[:, _LOGS]) * 2.0**LOG_BITS - info.centres
        offsets = anchors.present_offsets.reshape(len(anchors.mask), -1).astype(np.float64)
        parts = (
            anchors.features.astype(np.float64) / np.repeat(info.steps[:-1], groups),
            logs / info.log_steps[[0, 1, 1, 1]],
            offsets / info.steps[-1],
        )
        for part in parts:
            if np.abs(part).max(initial=0) > MAX_NUMBER:
                raise InvalidValueError("an attribute is too large for its quantisation step")
        self._values = np.concatenate(parts, axis=1)

    def expected_bytes(self) -> float:
        """Bytes that all packets will take, from a sample of the anchors."""
        ranks = np.random.default_rng(SAMPLE_SEED).permutation(len(self._masks))[:SAMPLE]
        return float(anchor_bits(self._context, self._quantised(ranks)).mean()) * len(self._masks) / 8

    def encode(self, ranks: np.ndarray, counts: np.ndarray, packet_bytes: int | None) -> CodedPackets:
        """See `AnchorCoder.encode`."""
        found = self._quantised(ranks)
        if packet_bytes is not None:
            counts = cut_packets(self._context, found, counts, packet_bytes)
        return CodedPackets(counts, encode_packets(self._context, found, counts), (found.rows(),))

    def _quantised(self, ranks: np.ndarray) -> Quantised:
        places = self._places.select(ranks)
        return quantise(self._context, places, self._masks[ranks], self._values[ranks], self._octaves)
