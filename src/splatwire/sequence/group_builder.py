"""Collects the frames of a group of pictures (GOP) into tracks (one Gaussian over several frames)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatwire.codec.sequence.track_group import TrackGroup
from splatwire.codec.sequence.trajectories import Trajectories
from splatwire.sequence.partial_tracks import (
    NUM_NEIGHBORS,
    NUM_SPARE_NEIGHBORS,
    NeighborIndex,
    NeighborSet,
    TrackedFrame,
    extrapolate_partial_tracks,
    first_gaussians,
    sample_neighbors,
)
from splatwire.types.splats import Splats

SPARE_DIVISOR = 8
"""Inverse of the spare array capacity for new tracks: one eighth of the current number of tracks."""
MAX_EARLY_SEARCHES = 1 << 13
"""Maximum number of partial tracks (which do not exist in all frames) with a neighbour search before the group is
complete; limits memory."""


class GroupBuilder:
    """Collects the frames of a group of pictures, and joins their Gaussians to tracks (one Gaussian over time).

    Args:
        max_frames: Maximum number of frames of the group.
        was_coherent: True if most tracks of the previous group moved like their neighbours. Neighbours are then
            searched while frames arrive, which saves time at the end of the group.
    """

    def __init__(self, max_frames: int, *, was_coherent: bool = False) -> None:
        self._max_frames, self._search_early = max_frames, was_coherent
        self.frames: list[TrackedFrame] = []
        self._keys = self._key_order = self._begins = self._ends = np.zeros(0, np.int64)
        self._capacity = 0
        self._values: dict[str, np.ndarray] = {}
        self._neighbor_sets: list[NeighborSet] = []
        self._tree: NeighborIndex | None = None
        self._sample: NeighborSet | None = None
        self.is_coherent = False

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: TrackedFrame) -> None:
        """Adds the next frame of the group."""
        number = len(self.frames)
        self.frames.append(frame)
        rows = self._rows_of(frame.keys)
        for name, values in _varying_attributes(frame.splats).items():
            self._values[name][rows, number] = values
        self._ends[rows] = number + 1
        if self._search_early:
            self._find_neighbors(number)

    def _rows_of(self, keys: np.ndarray) -> np.ndarray:
        """Finds the track of each Gaussian of the latest frame; a Gaussian with a new key begins a new track.

        Args:
            keys: Key of each Gaussian, which is the same in all frames of its track, int64 (M).

        Returns:
            Index of the track within this group for each Gaussian, int64 (M).
        """
        order, number = self._key_order, len(self.frames) - 1
        ranks = np.searchsorted(self._keys, keys, sorter=order)
        has_row = np.zeros(len(keys), bool)
        if len(order):
            has_row = self._keys[order[np.minimum(ranks, len(order) - 1)]] == keys
        if not has_row.all():
            new_keys = np.sort(keys[~has_row])
            self._keys = np.concatenate([self._keys, new_keys])
            self._begins = np.concatenate([self._begins, np.full(len(new_keys), number)])
            self._ends = np.concatenate([self._ends, np.full(len(new_keys), number)])
            self._key_order = order = np.argsort(self._keys, kind="stable")
            ranks = np.searchsorted(self._keys, keys, sorter=order)
        if not self._values or len(self._keys) > self._capacity:
            self._grow(len(self._keys) + len(self._keys) // SPARE_DIVISOR)
        return order[ranks]

    def _grow(self, count: int) -> None:
        """Enlarges the arrays of the group to `count` tracks."""
        self._capacity = count
        for name, values in _varying_attributes(self.frames[-1].splats).items():
            grown = np.zeros((count, self._max_frames, *values.shape[1:]), np.float32)
            if name in self._values:
                grown[: len(self._values[name])] = self._values[name]
            self._values[name] = grown

    def _find_neighbors(self, number: int) -> None:
        """Finds the neighbours of the tracks that begin in a frame, and of the tracks that ended in the frame before.

        Args:
            number: Index of the frame in the group.
        """
        means, count = self._values["means"], NUM_NEIGHBORS + NUM_SPARE_NEIGHBORS
        since_start = np.flatnonzero((self._begins == 0) & (self._ends == number + 1))
        ended = np.flatnonzero(self._ends == number)
        num_searches_left = MAX_EARLY_SEARCHES - sum(len(neighbor_set.tracks) for neighbor_set in self._neighbor_sets)
        if number and self._tree is not None and 0 < len(ended) <= num_searches_left:
            self._neighbor_sets.append(self._tree.nearest(means, ended, count))
        self._tree = None
        if not len(since_start) or number == self._max_frames - 1:
            return
        self._tree = NeighborIndex.of(means, number, since_start)
        if not number:
            self._sample = sample_neighbors(means, self._tree)
        begun = np.flatnonzero(self._begins == number)
        if number and 0 < len(begun) <= num_searches_left - len(ended):
            self._neighbor_sets.append(self._tree.nearest(means, begun, count))

    def tracks_so_far(self) -> tuple[np.ndarray, Trajectories, int]:
        """Returns keys and attributes of the tracks of the frames added so far, and the number of these frames.

        Partial tracks are not extrapolated. The arrays are views of arrays that `group` changes.
        """
        count = len(self._keys)
        return (
            self._keys,
            Trajectories(**{name: values[:count] for name, values in self._values.items()}),
            len(self.frames),
        )

    def group(self) -> TrackGroup:
        """Returns the group of all frames added so far.

        Every track has attributes in every frame. In frames before its first frame, a track has the attributes of its
        first frame. In frames after its last frame, it has the attributes of its last frame. Positions are an
        exception: if most tracks of the group move like their neighbours, the positions of those that do follow the
        motion of the neighbours in these frames.
        """
        count, number = len(self._keys), len(self.frames)
        values = {name: values[:count, :number] for name, values in self._values.items()}
        for array in values.values():
            _repeat_ends(array, self._begins, self._ends)
        self.is_coherent = extrapolate_partial_tracks(
            values["means"], self._begins, self._ends, self._neighbor_sets, self._sample
        )
        keys, begins, ends, frames = self._keys, self._begins, self._ends, self.frames
        if not np.array_equal(self._key_order, np.arange(count)):
            keys, begins, ends = keys[self._key_order], begins[self._key_order], ends[self._key_order]
            values = {name: array[self._key_order] for name, array in values.items()}
        values = {name: np.ascontiguousarray(array) for name, array in values.items()}

        def keyframe_gaussians(rows: np.ndarray) -> Splats:
            keyframes = first_gaussians(frames, keys[rows], begins[rows])
            return replace(keyframes, means=values["means"][rows, 0])

        return TrackGroup(keys, begins, ends, Trajectories(**values), keyframe_gaussians)


def group_of(frames: Sequence[TrackedFrame]) -> TrackGroup:
    """Joins the Gaussians of consecutive frames to the tracks of one group of pictures."""
    builder = GroupBuilder(len(frames))
    for frame in frames:
        builder.add(frame)
    return builder.group()


def _varying_attributes(splats: Splats) -> dict[str, np.ndarray]:
    """Returns the attributes of Gaussians that can change over time, by name."""
    names = ("means", "quats", "scales", "opacities")
    return {**{name: getattr(splats, name) for name in names}, "colours": splats.sh[:, 0]}


def _repeat_ends(values: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> None:
    """Fills frames outside of a track's lifetime with the first or the last value of an attribute, in place.

    Args:
        values: Attribute of n tracks in F frames, (n, F, ...).
        begins: First frame of each track.
        ends: First frame after each track.
    """
    num_frames = values.shape[1]
    ends_early, begins_late = np.flatnonzero(ends < num_frames), np.flatnonzero(begins > 0)
    for frame in range(1, num_frames):
        ended = ends_early[ends[ends_early] <= frame]
        values[ended, frame] = values[ended, frame - 1]
    for frame in range(num_frames - 2, -1, -1):
        unborn = begins_late[begins[begins_late] > frame]
        values[unborn, frame] = values[unborn, frame + 1]
