"""Input of the sequence encoder: tracks (Gaussians over time) in a group of frames."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.codec.sequence.trajectories import Trajectories
from splatwire.types.splats import Splats


@dataclass(frozen=True, eq=False)
class TrackGroup:
    """Tracks (Gaussians that persist over frames) in one group of frames.

    Attributes:
        keys: Key of each track, which identifies its Gaussian in all groups; ascending, int64 (n). The stream stores a
            Gaussian that moves far as several tracks, one after another.
        begins: First frame of each track, relative to the group, int64 (n).
        ends: First frame after the end of each track, relative to the group, int64 (n).
        trajectories: Trajectories of the tracks over the group.
        keyframe_gaussians: Function that returns the keyframe Gaussians of tracks, given an array of track indices in
            the group. They have the attributes of the track in its first frame, except for the position. The position
            is for the first frame of the group, and is extrapolated for tracks that begin later.
    """

    keys: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    trajectories: Trajectories
    keyframe_gaussians: Callable[[np.ndarray], Splats]
