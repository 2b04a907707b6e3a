"""Properties of an encoded sequence."""

from typing import Any

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.sequence.tracking import SECTION as TRACKING
from splatwire.sequence.tracking import TrackingReport


def describe_sequence(stream: "SceneStream") -> dict[str, Any]:
    """Returns properties of an encoded sequence by name, such as the numbers of frames and Gaussians."""
    manifest, plan = stream.manifest, stream.manifest.plan
    info = open_side_info(manifest, stream.side_info)
    sizes = {True: 0, False: 0}
    for packet in stream.packets:
        sizes[plan.is_keyframe(packet.id.block)] += packet.num_bytes
    births, time_ = [group.num_births for group in info.groups], info.timeline
    tracking = TrackingReport.read(info.sections[TRACKING]) if TRACKING in info.sections else None
    return {
        "frames": time_.num_frames,
        "frame_rate": float(time_.rate),
        "group_frames": time_.group_frames,
        "seconds": float(time_.num_frames / time_.rate),
        "num_tracks": sum(births),
        "born_later": sum(births[1:]),
        "groups": len(births),
        "groups_without_motion": sum(not group.num_motion_tracks for group in info.groups),
        "base_bytes": sizes[True],
        "motion_bytes": sizes[False],
        "bytes_per_track_and_frame": stream.num_bytes / max(sum(births) * time_.num_frames, 1),
        "frames_matched": None if tracking is None else tracking.num_matched_frames,
        "share_matched": None if tracking is None else tracking.matched_share,
    }


def count_motions(stream: "SceneStream") -> dict[str, Any]:
    """Returns statistics on the motion of all Gaussians of a sequence, by name.

    A track is one Gaussian over time. `died` is the number of tracks that end before the sequence ends. `still_share`
    is the fraction of tracks that do not move within a group of pictures, 0 to 1, over all groups.
    """
    sequence = decode_stream(stream).scene
    alive, num_present, still = np.zeros(sequence.num_gaussians, bool), 0, 0
    for group in range(sequence.timeline.num_groups):
        motion = sequence.motion(group, sequence.tracks.received)
        if motion.unchanged:
            alive |= sequence.tracks.born == group
            num_in_group = standing = int(alive.sum())
        else:
            alive[:] = False
            alive[motion.tracks[motion.ends == len(sequence.timeline.frames_of(group))]] = True
            num_in_group, standing = len(motion.tracks), int((~motion.moving).sum())
        num_present, still = num_present + num_in_group, still + standing
    return {"died": int((~alive).sum()), "still_share": still / num_present if num_present else 1.0}
