"""Importance of motion packets, without rendering."""

from collections.abc import Sequence

import numpy as np

from splatwire.bitstream import Manifest, Packet, PacketId, SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence.known_tracks import visibility_of
from splatwire.codec.sequence.layout import MOVING, STATE, TRACK
from splatwire.codec.sequence.motion_rows import decode_motion
from splatwire.codec.sequence.side_info import open_side_info


def packet_importance(
    manifest: Manifest, side_info: bytes, packets: Sequence[Packet], visibility: np.ndarray
) -> list[float]:
    """Estimates how visible the loss of each packet would be: the total visibility of the tracks that the packet moves.

    The result is 0 for keyframe packets. A track is one Gaussian over time.

    Args:
        manifest: Manifest of the sequence.
        side_info: Side information of the sequence (data that all packets need).
        packets: Some packets of the sequence.
        visibility: Visibility of each track, from `visibility_of`.
    """
    # In two test sequences, the loss of a quarter of the packets causes 0.4 to 0.8 of the total distortion, and this
    # estimate finds most of these packets. The size of a packet is a worse estimate: motion that differs from the
    # neighbours' motion takes many bits, but is less visible.
    info, plan = open_side_info(manifest, side_info), manifest.plan
    first_new = np.cumsum([0, *(group.num_births for group in info.groups)])

    def importance_of(packet: Packet) -> float:
        if plan.is_keyframe(packet.id.block):
            return 0.0
        group = plan.gop_of_block(packet.id.block)
        headers, _, _ = decode_motion(
            info, group, np.array([packet.num_elements]), [packet.payload], int(first_new[group])
        )
        moving = headers[headers[:, STATE] == MOVING, TRACK]
        # Arbitrary bytes decode to some tracks, which may be out of range.
        return float(visibility[moving[(moving >= 0) & (moving < len(visibility))]].sum())

    return [importance_of(packet) for packet in packets]


def stream_importance(stream: SceneStream) -> dict[PacketId, float]:
    """Returns the importance of all packets of a complete sequence, by packet id."""
    splats = decode_stream(stream).scene.tracks.splats
    visibility = visibility_of(splats.scales, splats.opacities)
    importance = packet_importance(stream.manifest, stream.side_info, stream.packets, visibility)
    return {packet.id: value for packet, value in zip(stream.packets, importance, strict=True)}
