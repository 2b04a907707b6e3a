"""What an encoder remembers of tracks from group to group."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.layout import COLUMNS
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.codec.schemas.tracks.track_group import TrackGroup
from splatwire.codec.schemas.tracks.trajectories import Trajectories
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class KnownTracks:
    """Tracks that were born so far.

    Attributes:
        keys: Key of each, int64 (T).
        by_key: Tracks in the order of their keys; of one key, as they were born, int64 (T).
        bases: How each looked when it was born.
        rows: Integers of each, int64 (T, COLUMNS).
        shifts: log2 of the steps of its motion, int64 (T, C).
        weights: How much is seen of each, see `weights_of`, float64 (T).
        alive: Those that are there at the end of the last group, ascending, int64.
    """

    keys: np.ndarray
    by_key: np.ndarray
    bases: Trajectories
    rows: np.ndarray
    shifts: np.ndarray
    weights: np.ndarray
    alive: np.ndarray

    @staticmethod
    def empty() -> "KnownTracks":
        """Nobody."""
        empty = Trajectories(*(np.zeros((0, 1, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (3,))))
        none = np.zeros(0, np.int64)
        rows, shifts = (np.zeros((0, count), np.int64) for count in (COLUMNS, NUM_CHANNELS))
        return KnownTracks(none, none, empty, rows, shifts, np.zeros(0), none)

    def numbers_of(self, keys: np.ndarray) -> np.ndarray:
        """The track of each key, the last one that it was given; -1 where it has none, int64."""
        if not len(self.keys):
            return np.full(len(keys), -1, np.int64)
        names = self.keys[self.by_key]
        at = np.maximum(np.searchsorted(names, keys, side="right") - 1, 0)
        return np.where(names[at] == keys, self.by_key[at], -1)

    def leaving(self, frames: int) -> TrackGroup:
        """A group that nobody is there in: its one track, of those that are alive, ends before the first frame."""
        one, none = self.alive[-1:], np.zeros(1, np.int64)
        poses = {name: np.repeat(values[one], frames, axis=1) for name, values in vars(self.bases).items()}
        return TrackGroup(self.keys[one], none, none, Trajectories(**poses), _nobody)

    def with_births(self, bases: Trajectories, keys: np.ndarray, rows: np.ndarray, shifts: np.ndarray) -> "KnownTracks":
        """With tracks that are born, in the order of their numbers: trajectories of one frame, and what is theirs."""
        joined = {name: np.concatenate([old, getattr(bases, name)]) for name, old in vars(self.bases).items()}
        names = np.concatenate([self.keys, keys])
        return KnownTracks(
            names,
            np.argsort(names, kind="stable"),
            Trajectories(**joined),
            np.concatenate([self.rows, rows]),
            np.concatenate([self.shifts, shifts]),
            np.concatenate([self.weights, weights_of(bases.scales[:, 0], bases.opacities[:, 0])]),
            self.alive,
        )


def _nobody(_: np.ndarray) -> Splats:
    raise AssertionError("nobody is born in a group that nobody is there in")


def weights_of(scales: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """How much is seen of Gaussians: squared opacity times the largest area that they show, float64 (T).

    Args:
        scales: (T, 3).
        opacities: (T).
    """
    rising = np.sort(scales.astype(np.float64), axis=1)
    weights: np.ndarray = rising[:, 1] * rising[:, 2] * opacities.astype(np.float64) ** 2
    return weights
