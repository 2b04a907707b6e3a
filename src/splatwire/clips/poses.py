"""Where tracks are in the frames of a group, and what is known of them when it ends."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class GroupPoses:
    """Where every track that is drawn is, in each frame of a group.

    Attributes:
        tracks: They, ascending, int64 (n).
        begins: First frame of each, counted from the group's, int64 (n).
        ends: First frame after each, int64 (n).
        concealed: Tracks whose motion was lost, bool (n).
        at: See `GroupMotion.at`, float32 (n, C) of all.
    """

    tracks: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    concealed: np.ndarray
    at: Callable[[int], np.ndarray]


@dataclass(frozen=True, eq=False)
class Memory:
    """What is known when a group ends.

    Attributes:
        alive: Tracks that are there then, bool (T).
        offsets: How each differs from its base in the last frame, float32 (T, C).
        velocity: Change of that from the frame before, float32 (T, C).
        concealed: Whether that was a guess, bool (T).
    """

    alive: np.ndarray
    offsets: np.ndarray
    velocity: np.ndarray
    concealed: np.ndarray

    def grown(self, num_tracks: int) -> "Memory":
        """The same where more tracks are known of, none of which was there."""
        more = num_tracks - len(self.alive)
        if not more:
            return self
        return Memory(**{
            name: np.concatenate([values, np.zeros((more, *values.shape[1:]), values.dtype)])
            for name, values in vars(self).items()
        })  # fmt: skip
