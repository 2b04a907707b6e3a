"""What an encoder of clips takes: tracks over a group of frames."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.tracks.trajectories import Trajectories
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class TrackGroup:
    """Tracks over a group of frames.

    Attributes:
        keys: Name of each track, the same in every group that it is in, ascending, int64 (n).
        begins: First frame of each, counted from the group's, int64 (n).
        ends: First frame after each, int64 (n).
        moves: What they do.
        first: Of some of them, by their index: each as `moves` has it in the first frame, with all harmonics.
    """

    keys: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    moves: Trajectories
    first: Callable[[np.ndarray], Splats]
