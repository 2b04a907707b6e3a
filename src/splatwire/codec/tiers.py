"""Importance tier of each element: a named section of the side information of streams with several tiers."""

from collections.abc import Mapping

import numpy as np

from splatwire.bitstream import Manifest, PacketAssignment, PacketMembers, SceneStream, assign_packets, tier_order
from splatwire.bitstream.sections import sections_of
from splatwire.codec import _tier_kernels as kernels
from splatwire.entropy.coder import fresh_models
from splatwire.errors import BitstreamError

SECTION = "tiers"
"""Name of the section."""


def encode_tiers(tiers: np.ndarray, num_tiers: int) -> bytes:
    """Entropy-codes the importance tier of every element.

    Args:
        tiers: Importance tier of each element in the order of the decoded scene, 0 for the most important, (N).
        num_tiers: Number of tiers.
    """
    models = fresh_models((num_tiers - 1) * kernels.STATES)
    buffer = np.empty(2 * (num_tiers - 1) * len(tiers) + 64, dtype=np.uint8)
    length = kernels.encode_tiers(np.ascontiguousarray(tiers, dtype=np.uint8), num_tiers, models, buffer)
    return buffer[:length].tobytes()


def decode_tiers(data: bytes, num_elements: int, num_tiers: int) -> np.ndarray:
    """Decodes the importance tiers written by `encode_tiers`.

    Returns:
        Importance tier of each element, uint8 (N).
    """
    models, tiers = fresh_models((num_tiers - 1) * kernels.STATES), np.empty(num_elements, dtype=np.uint8)
    kernels.decode_tiers(np.frombuffer(data, dtype=np.uint8), num_tiers, models, tiers)
    return tiers


def read_tiers(sections: Mapping[str, bytes], manifest: Manifest) -> np.ndarray:
    """Returns the importance tier of each element of a stream, in the order of the decoded scene.

    Args:
        sections: Named sections of the stream's side information.
        manifest: The stream's manifest.

    Returns:
        Importance tier of each element, uint8 (N).

    Raises:
        BitstreamError: If manifest and side information contradict each other.
    """
    tier_counts = manifest.tiers
    if bool(tier_counts) != (SECTION in sections):
        raise BitstreamError("manifest and side information disagree on whether there are tiers")
    if not tier_counts:
        return np.zeros(manifest.num_elements, dtype=np.uint8)
    tiers = decode_tiers(sections[SECTION], manifest.num_elements, len(tier_counts))
    counts = np.bincount(tiers, minlength=len(tier_counts)).tolist()
    if counts != [tier.num_elements for tier in tier_counts]:
        raise BitstreamError(f"the side information has tiers of {counts} elements, which the manifest denies")
    return tiers


def assign_stream_packets(stream: SceneStream) -> PacketAssignment:
    """Assigns each element of a stream to its received packet, or to a gap if its packet is lost.

    In the result, elements are given by their index before sorting by importance tier.

    Raises:
        BitstreamError: If the side information is damaged.
    """
    members, packets = assign_packets(stream.manifest.plan, stream.packets)
    if not stream.manifest.tiers:
        return PacketAssignment(members, packets)
    order = tier_order(read_tiers(sections_of(stream), stream.manifest))
    return PacketAssignment(PacketMembers(order[members.indices], members.starts), packets)
