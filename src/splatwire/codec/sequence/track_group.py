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
        keys: Key of each track, which identifies the track in all groups; ascending, int64 (n).
        begins: First frame of each track, relative to the group, int64 (n).
        ends: First frame after the end of each track, relative to the group, int64 (n).
        moves: Trajectories of the tracks over the group.
        first: Function that returns the Gaussians to encode as keyframe Gaussians, given an array of track indices in
            the group. The attributes of a Gaussian are those of its track in the first frame of the track. The position
            is an exception: it is the position of the track in the first frame of the group, which may be extrapolated.
    """

    keys: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    moves: Trajectories
    first: Callable[[np.ndarray], Splats]
