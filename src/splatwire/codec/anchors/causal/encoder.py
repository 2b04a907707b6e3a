"""Encoder of the codec `causal` for neural anchors."""

from dataclasses import replace

import numpy as np

from splatwire.anchors.voxels import voxel_indices
from splatwire.bitstream import Packetization
from splatwire.codec.anchors.causal.context import CodingContext
from splatwire.codec.anchors.causal.fit import fit_side_info
from splatwire.codec.anchors.causal.packet_coder import (
    Quantised,
    anchor_bits,
    encode_packets,
    quantise,
    split_into_packets,
)
from splatwire.codec.anchors.causal.positions import CoarsePositions, encode_coarse_positions
from splatwire.codec.anchors.causal.side_info import LOG_BITS, SideInfo, read_side_info, write_side_info
from splatwire.codec.schema import CodedPackets
from splatwire.errors import InvalidValueError
from splatwire.ops.morton import morton_encode
from splatwire.types import Anchors, AnchorScene

_LOG_SCALINGS = [0, 3, 4, 5]
"""Indices of the coded scalings among an anchor's six: the offset scale (once), and the sizes along x, y, z. They are
coded as logarithms.
"""
MAX_SIDE_INFO_SHARE = 0.08
"""Maximum share of side information in a stream. If it is larger, bits of positions are moved to the packets."""
MAX_LEAF_ANCHORS = 8
"""Maximum number of anchors that share a leaf of the position tree, which limits the moved bits."""
SAMPLE_SEED = 0
SAMPLE_SIZE = 1000
"""Number of anchors from which the bytes of all packets are estimated."""
MAX_QUANTISED = 14_000
"""Largest magnitude of anchors' attributes, in quantisation steps, so that attributes and means fit into 32 bits."""


def causal_encoder(
    scene: AnchorScene, packetization: Packetization, sections: dict[str, bytes], network_tolerance: float | None
) -> tuple["CausalEncoder", bytes]:
    """Returns the encoder of a scene's anchors, and the side information, which is fitted to the scene.

    Args:
        scene: The scene, with anchors in coding order.
        packetization: Parameters of the division into packets.
        sections: Named sections of the side information.
        network_tolerance: Tolerated error of the quantised networks' outputs, relative to the predicted standard
            deviation; None for the default.

    Raises:
        InvalidValueError: If the packets are separated by attribute, the order is not Morton, or the scene exceeds the
            format's limits.
    """
    _check_packetization(packetization)
    scene = replace(scene, anchors=_with_positive_scalings(scene.anchors))
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    info = fit_side_info(scene, voxels, network_tolerance=network_tolerance)
    positions = _split_position_bits(info, voxels, CausalEncoder(scene, info, voxels).expected_bytes())
    side_info = write_side_info(replace(info, positions=positions, sections=sections))
    # Predict from the side information as a decoder reads it, after quantisation.
    info = read_side_info(side_info, scene.anchors.num_anchors)
    return CausalEncoder(scene, info, voxels), side_info


def causal_repack_encoder(
    scene: AnchorScene, packetization: Packetization, side_info: bytes
) -> tuple["CausalEncoder", bytes]:
    """Creates an encoder that divides the decoded anchors of an existing stream into new packets.

    Args:
        scene: The anchors decoded from the stream.
        packetization: Parameters of the new division into packets.
        side_info: Side information of the stream, serialised.

    Returns:
        The encoder, and the unchanged side information of the stream.

    Raises:
        InvalidValueError: If the packets are separated by attribute, or the order is not Morton.
        BitstreamError: If the side information is damaged.
    """
    _check_packetization(packetization)
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    return CausalEncoder(scene, read_side_info(side_info, scene.anchors.num_anchors), voxels), side_info


def _check_packetization(packetization: Packetization) -> None:
    if not packetization.universal:
        raise InvalidValueError(
            "anchors of the causal model are coded whole and in Morton order: preset 'hacpp' is for those of HAC++"
        )


def _split_position_bits(info: SideInfo, voxels: np.ndarray, bytes_of_packets: float) -> CoarsePositions:
    """Chooses how many bits of the anchors' positions are in the side information; the other bits are in packets.

    The result is the largest number of bits with which the side information takes at most about a fixed share of the
    stream.

    Args:
        info: Side information with the maximum number of position bits.
        voxels: Positions of the N anchors as indices of voxels, int64 (N, 3).
        bytes_of_packets: Expected size of all packets together, bytes.

    Returns:
        Section of the side information with the high bits of the positions, and probabilities for coding the low bits
        in packets.
    """
    # Side information delays the first picture, so its share of all bytes is limited to about `MAX_SIDE_INFO_SHARE`.
    # The limit of anchors per leaf takes precedence.
    positions, other_bytes = info.positions, len(write_side_info(info)) - len(info.positions.section)
    max_section_bytes = MAX_SIDE_INFO_SHARE * (other_bytes + len(positions.section) + bytes_of_packets) - other_bytes
    for max_leaf in range(2, MAX_LEAF_ANCHORS + 1):
        if len(positions.section) <= max_section_bytes:
            break
        positions = encode_coarse_positions(voxels, max_leaf)
    return positions


def _with_positive_scalings(anchors: Anchors) -> Anchors:
    """Replaces scalings of 0 by the smallest positive scaling, because logarithms of scalings are coded."""
    positive = anchors.scalings > 0
    if bool(positive.all()):
        return anchors
    if not bool(positive.any()):
        raise InvalidValueError("no scaling of the scene's anchors is positive")
    return replace(anchors, scalings=np.maximum(anchors.scalings, anchors.scalings[positive].min()))


class CausalEncoder:
    """Encodes the anchors of one scene under the causal model.

    Args:
        scene: The scene, with anchors in coding order.
        info: Side information of the scene's stream.
        voxels: int64 (N, 3), voxel indices of the anchors.

    Raises:
        InvalidValueError: If an attribute is too large for its step.
    """

    def __init__(self, scene: AnchorScene, info: SideInfo, voxels: np.ndarray) -> None:
        anchors, groups, positions = scene.anchors, info.config.layout.feature_groups, info.positions.known
        self._context = CodingContext.of(info)
        self._positions = replace(positions, codes=morton_encode(voxels - positions.corner))
        self._offset_scale_step = float(info.steps_of_logs[0]) * 2.0**-LOG_BITS
        self._masks = anchors.mask.astype(np.uint8)
        logs = np.log2(anchors.scalings.astype(np.float64)[:, _LOG_SCALINGS]) * 2.0**LOG_BITS - info.zero_points
        offsets = anchors.present_offsets.reshape(len(anchors.mask), -1).astype(np.float64)
        parts = (
            anchors.features.astype(np.float64) / np.repeat(info.linear_steps[:-1], groups),
            logs / info.steps_of_logs[[0, 1, 1, 1]],
            offsets / info.linear_steps[-1],
        )
        for part in parts:
            if np.abs(part).max(initial=0) > MAX_QUANTISED:
                raise InvalidValueError("an attribute is too large for its quantisation step")
        self._values = np.concatenate(parts, axis=1)

    def expected_bytes(self) -> float:
        """Estimated bytes of all packets, from a sample of the anchors."""
        ranks = np.random.default_rng(SAMPLE_SEED).permutation(len(self._masks))[:SAMPLE_SIZE]
        return float(anchor_bits(self._context, self._quantised(ranks)).mean()) * len(self._masks) / 8

    def encode(self, ranks: np.ndarray, counts: np.ndarray, max_payload_bytes: int | None) -> CodedPackets:
        """Encodes groups of anchors; each group becomes one packet, or several packets of limited size.

        Args:
            ranks: Indices, in coding order, of the n anchors to encode: first the anchors of group 0, then those of
                group 1, and so on, int64 (n).
            counts: Number of anchors of each group, int64 (groups).
            max_payload_bytes: Maximum payload size; larger groups are divided. None to leave groups undivided.
        """
        quantised = self._quantised(ranks)
        if max_payload_bytes is not None:
            counts = split_into_packets(self._context, quantised, counts, max_payload_bytes)
        return CodedPackets(counts, encode_packets(self._context, quantised, counts), (quantised.rows(),))

    def _quantised(self, ranks: np.ndarray) -> Quantised:
        positions = self._positions.select(ranks)
        return quantise(self._context, positions, self._masks[ranks], self._values[ranks], self._offset_scale_step)
