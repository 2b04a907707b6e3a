"""What an encoder remembers of tracks from group to group."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.layout import COLUMNS
from splatwire.codec.schemas.tracks.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class KnownTracks:
    """Tracks that were born so far.

    Attributes:
        keys: Key of each, int64 (T).
        bases: How each looked when it was born.
        rows: Integers of each, int64 (T, COLUMNS).
        alive: Those that are there at the end of the last group, ascending, int64.
    """

    keys: np.ndarray
    bases: Trajectories
    rows: np.ndarray
    alive: np.ndarray

    @staticmethod
    def empty() -> "KnownTracks":
        """Nobody."""
        empty = Trajectories(*(np.zeros((0, 1, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (3,))))
        none = np.zeros(0, np.int64)
        return KnownTracks(none, empty, np.zeros((0, COLUMNS), np.int64), none)

    def numbers_of(self, keys: np.ndarray) -> np.ndarray:
        """The track of each key, the last one that it was given, int64."""
        order = np.argsort(self.keys, kind="stable")
        return order[np.searchsorted(self.keys[order], keys, side="right") - 1]

    def with_births(self, bases: Trajectories, keys: np.ndarray, rows: np.ndarray) -> "KnownTracks":
        """With tracks that are born, in the order of their numbers: trajectories of one frame, keys, integers."""
        joined = {name: np.concatenate([old, getattr(bases, name)]) for name, old in vars(self.bases).items()}
        return KnownTracks(
            np.concatenate([self.keys, keys]),
            Trajectories(**joined),
            np.concatenate([self.rows, rows]),
            self.alive,
        )
