"""Extrapolates the motion of Gaussians that do not exist in all frames of a group."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.concealment.temporal.neighbors import smooth_weights
from splatwire.ops.kd_tree import build_kd_tree
from splatwire.types.splats import Splats

NUM_NEIGHBORS = 40
"""Number of neighbours that extrapolate a track's position."""
MAX_DEVIATION = 0.25
"""Maximum squared deviation from the neighbours' motion, relative to a track's own squared motion, to count as
coherent.
"""
SAMPLE_SIZE = 512
"""Number of tracks sampled for the test of coherent motion."""
NUM_SPARE_NEIGHBORS = 16
"""Number of additional neighbours found early, because some may end before the group does."""
BATCH_SIZE = 1 << 12
"""Number of tracks processed at a time."""


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """Gaussians of a frame, each assigned to a track. A track is one Gaussian over time.

    Attributes:
        splats: The M Gaussians.
        keys: Key of the track of each Gaussian, the same number in all frames of the track, int64 (M).
    """

    splats: Splats
    keys: np.ndarray


@dataclass(frozen=True, eq=False)
class NeighborSet:
    """Nearest neighbours of n tracks, from which the motion of the tracks is interpolated.

    A track is one Gaussian over time.

    Attributes:
        tracks: Indices of the n tracks, int64 (n).
        frames: Frame in which the distances of each track to its neighbours were measured, int64 (n).
        neighbors: Indices of the nearest other tracks, nearest first, int64 (n, k).
        weights: Interpolation weights of the nearest `NUM_NEIGHBORS` neighbours, float32 (n, `NUM_NEIGHBORS` or fewer).
    """

    tracks: np.ndarray
    frames: np.ndarray
    neighbors: np.ndarray
    weights: np.ndarray

    @staticmethod
    def with_weights(means: np.ndarray, tracks: np.ndarray, frames: np.ndarray, neighbors: np.ndarray) -> "NeighborSet":
        """Creates a neighbour set; computes the weights from the distances of the neighbours.

        Args:
            means: Positions of all tracks in all frames, float32 (T, F, 3).
            tracks: Indices of the tracks, int64 (n).
            frames: Frame in which the distances of each track to its neighbours are measured, int64 (n).
            neighbors: Indices of the nearest other tracks, nearest first, int64 (n, k).
        """
        positions = means[neighbors[:, :NUM_NEIGHBORS], frames[:, None]]
        return NeighborSet(tracks, frames, neighbors, smooth_weights(positions - means[tracks, frames][:, None]))

    @staticmethod
    def joined(parts: "Sequence[NeighborSet]") -> "NeighborSet":
        """Concatenates several neighbour sets."""
        names, count = ("tracks", "frames", "neighbors", "weights"), min(part.neighbors.shape[1] for part in parts)
        values = {name: [getattr(part, name) for part in parts] for name in names}
        values["neighbors"] = [neighbors[:, :count] for neighbors in values["neighbors"]]
        return NeighborSet(*(np.concatenate(values[name]) for name in names))

    def only(self, exists: np.ndarray, means: np.ndarray) -> "NeighborSet":
        """Returns the set restricted to permitted neighbours, with recomputed weights.

        Args:
            exists: Mask of the tracks that are allowed as neighbours, bool (T).
            means: Positions of all tracks in all frames, float32 (T, F, 3).
        """
        is_allowed = exists[self.neighbors]
        same, enough = is_allowed[:, :NUM_NEIGHBORS].all(axis=1), is_allowed.sum(axis=1) >= NUM_NEIGHBORS
        other = enough & ~same
        first = np.argsort(~is_allowed[other], axis=1, kind="stable")[:, :NUM_NEIGHBORS]
        neighbors = np.take_along_axis(self.neighbors[other], first, axis=1)
        # Tracks with too few allowed neighbours are omitted.
        return NeighborSet.joined([
            NeighborSet(self.tracks[same], self.frames[same], self.neighbors[same, :NUM_NEIGHBORS], self.weights[same]),
            NeighborSet.with_weights(means, self.tracks[other], self.frames[other], neighbors),
        ])  # fmt: skip

    def part(self, selection: np.ndarray | slice) -> "NeighborSet":
        """Returns the neighbours of a selection of the tracks.

        Args:
            selection: Positions of the selected tracks in the array `tracks`: indices, a mask or a slice.
        """
        return NeighborSet(
            self.tracks[selection], self.frames[selection], self.neighbors[selection], self.weights[selection]
        )

    def interpolated_motion(self, means: np.ndarray) -> np.ndarray:
        """Predicts the positions of tracks in all frames, (n, F, 3), from the motion of their neighbours.

        Args:
            means: Positions of all tracks, float32 (T, F, 3).
        """
        start, positions = means[self.tracks, self.frames][:, None], means[self.neighbors, self.frames[:, None]]
        # Motion beyond the range of float32 becomes infinite or NaN, so that no track moves like it.
        with np.errstate(over="ignore", invalid="ignore"):
            moved: np.ndarray = start + np.einsum(
                "nk,nkfa->nfa", self.weights, means[self.neighbors] - positions[:, :, None]
            )
        return moved


@dataclass(frozen=True, eq=False)
class NeighborIndex:
    """Search tree for the nearest neighbours of tracks in one frame. A track is one Gaussian over time.

    Attributes:
        frame: Index of the frame.
        rows: Index of the track of each point in the tree, int64.
        tree: Search tree (`cKDTree` of scipy).
    """

    frame: int
    rows: np.ndarray
    tree: Any

    @staticmethod
    def of(means: np.ndarray, frame: int, rows: np.ndarray) -> "NeighborIndex":
        """Builds the search tree from the positions of tracks in one frame.

        Args:
            means: Positions of all tracks in all frames, float32 (T, F, 3).
            frame: Index of the frame whose positions are used.
            rows: Indices of the tracks that may serve as neighbours, int64.
        """
        tree = build_kd_tree(
            means[rows, frame], balanced_tree=False, compact_nodes=False
        )  # fast to build, with few queries
        return NeighborIndex(frame, rows, tree)

    def nearest(self, means: np.ndarray, tracks: np.ndarray, count: int, begin: int = 0) -> NeighborSet:
        """Finds the nearest neighbours of tracks.

        Args:
            means: Positions of all tracks in all frames, float32 (T, F, 3).
            tracks: Indices of the tracks for which neighbours are searched, int64.
            count: Number of nearest tracks to find for each track, including the `begin` tracks that are omitted from
                the result.
            begin: Number of nearest tracks to omit. 1 if the tracks themselves are in the tree, because each track is
                then nearest to itself.
        """
        nearest = self.tree.query(means[tracks, self.frame], k=min(count, len(self.rows)))[1].reshape(len(tracks), -1)
        return NeighborSet.with_weights(means, tracks, np.full(len(tracks), self.frame), self.rows[nearest[:, begin:]])


def sample_neighbors(means: np.ndarray, index: NeighborIndex) -> NeighborSet:
    """Takes a sample of the tracks in a search tree, and finds their nearest neighbours in the tree.

    Args:
        means: Positions of all tracks in all frames, float32 (T, F, 3).
        index: Search tree. The sampled tracks are evenly spaced in its list of tracks.
    """
    sample = index.rows[np.linspace(0, len(index.rows) - 1, min(len(index.rows), SAMPLE_SIZE)).astype(np.int64)]
    return index.nearest(means, sample, NUM_NEIGHBORS + NUM_SPARE_NEIGHBORS + 1, begin=1)


def extrapolate_partial_tracks(
    means: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
    neighbor_sets: Sequence[NeighborSet],
    sample: NeighborSet | None,
) -> bool:
    """Extrapolates the positions of tracks that begin or end within a group of pictures to all frames of the group.

    A track (one Gaussian over time) that moves like its neighbours while it exists is moved like them before and after.
    Other tracks, and all if neighbours in a sample do not move alike, are not changed.

    Args:
        means: Positions of all tracks in the F frames of the group, float32 (n, F, 3); modified in place.
        begins: First frame of each track, int64 (n).
        ends: First frame after the end of each track, int64 (n).
        neighbor_sets: Neighbours that were already found for some of the tracks; may be empty.
        sample: Sample of tracks and their neighbours for testing whether neighbours move alike; None to choose the
            sample here.

    Returns:
        True if neighbours move alike, also if there was nothing to extrapolate. False if they do not, or if too few
        tracks are present in all frames; nothing is then changed.
    """
    # The decoder conceals lost motion in the same way (`concealment.temporal.motion_prediction`), so it finds nearly
    # the true position in the first frame of the track.
    num_frames = means.shape[1]
    is_full_length = (begins == 0) & (ends == num_frames)
    full_length = np.flatnonzero(is_full_length)
    if len(full_length) <= NUM_NEIGHBORS or not _is_coherent(means, is_full_length, sample):
        return False
    parts = [NeighborSet.joined(neighbor_sets).only(is_full_length, means)] if neighbor_sets else []
    begin_later, end_earlier = np.flatnonzero(begins > 0), np.flatnonzero(ends < num_frames)
    needed = np.union1d(
        begin_later * num_frames + begins[begin_later], end_earlier * num_frames + ends[end_earlier] - 1
    )
    missing = needed[
        ~np.isin(needed, np.concatenate([needed[:0], *(part.tracks * num_frames + part.frames for part in parts)]))
    ]
    for frame in np.unique(missing % num_frames).tolist():
        tracks = missing[missing % num_frames == frame] // num_frames
        index = NeighborIndex.of(means, frame, full_length)
        batches = np.array_split(tracks, -(-len(tracks) // BATCH_SIZE))
        parts += [index.nearest(means, batch, NUM_NEIGHBORS) for batch in batches]
    for part in parts:
        for begin in range(0, len(part.tracks), BATCH_SIZE):
            _extrapolate(means, begins, ends, part.part(slice(begin, begin + BATCH_SIZE)))
    return True


def _extrapolate(means: np.ndarray, begins: np.ndarray, ends: np.ndarray, neighbors: NeighborSet) -> None:
    """Fills in the positions of tracks in the frames before they begin and after they end.

    In these frames, a track moves like its neighbours, if it does so while it exists. Other tracks are not changed.

    Args:
        means: Positions of all tracks, float32 (n, F, 3); modified in place.
        begins: First frame of each track, int64 (n).
        ends: First frame after the end of each track, int64 (n).
        neighbors: Neighbours of the tracks to extrapolate.
    """
    tracks, at, num_frames = neighbors.tracks, neighbors.frames[:, None], means.shape[1]
    numbers = np.arange(num_frames)
    begin, end, own_positions, moved = (
        begins[tracks, None],
        ends[tracks, None],
        means[tracks],
        neighbors.interpolated_motion(means),
    )
    reference_positions = means[tracks, neighbors.frames][:, None].astype(np.float64)
    is_outside = (begin == at) & (numbers < at) | (end == at + 1) & (end < num_frames) & (numbers > at)
    is_similar = _moves_like(
        own_positions - reference_positions, moved - reference_positions, (begin <= numbers) & (numbers < end)
    )
    row, frame = np.nonzero(is_outside & is_similar[:, None])
    means[tracks[row], frame] = moved[row, frame]


def _is_coherent(means: np.ndarray, is_full_length: np.ndarray, sample: NeighborSet | None) -> bool:
    """True if most tracks move like their neighbours. A track is one Gaussian over time; a sample of tracks is tested.

    Args:
        means: Positions of all tracks in all frames, float32 (n, F, 3).
        is_full_length: Mask of the tracks that exist in all frames, bool (n).
        sample: Sample of tracks with their neighbours; None to draw the sample here.
    """
    tested = None if sample is None else sample.part(is_full_length[sample.tracks]).only(is_full_length, means)
    if tested is None or 2 * len(tested.tracks) < min(len(means), SAMPLE_SIZE):
        index = NeighborIndex.of(means, 0, np.flatnonzero(is_full_length))
        tested = sample_neighbors(means, index).only(is_full_length, means)
    own_positions, moved = means[tested.tracks].astype(np.float64), tested.interpolated_motion(means)
    return bool(
        _moves_like(
            own_positions - own_positions[:, :1], moved - own_positions[:, :1], np.ones(own_positions.shape[:2], bool)
        ).mean()
        > 0.5
    )


def _moves_like(motion: np.ndarray, neighbor_motion: np.ndarray, exists: np.ndarray) -> np.ndarray:
    """Returns a mask of tracks whose motion is similar to that of their neighbours, bool (n).

    Args:
        motion: Motion of the tracks, float64 (n, F, 3).
        neighbor_motion: Motion interpolated from the neighbours, float64 (n, F, 3).
        exists: Frames in which each track exists, bool (n, F).
    """
    squared_motion, squared_deviation = (
        np.where(exists, np.square(v).sum(axis=2), 0).sum(axis=1) for v in (motion, motion - neighbor_motion)
    )
    is_similar: np.ndarray = squared_deviation <= MAX_DEVIATION * squared_motion
    return is_similar


def first_gaussians(frames: Sequence[TrackedFrame], keys: np.ndarray, begins: np.ndarray) -> Splats:
    """Returns the Gaussian of each track (one Gaussian over time) in the first frame of the track.

    Args:
        frames: Gaussians of all frames of the group, each with the key of its track.
        keys: Keys of the tracks, int64 (n).
        begins: Index in `frames` of the first frame of each track, int64 (n).
    """
    parts, order = [], []
    for number, frame in enumerate(frames):
        beginning = np.flatnonzero(begins == number)
        if len(beginning) or not number:
            key_order = np.argsort(frame.keys, kind="stable")
            rows = key_order[np.searchsorted(frame.keys, keys[beginning], sorter=key_order)]
            parts.append(frame.splats.select(rows))
            order.append(beginning)
    joined = Splats(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})
    return joined.select(np.argsort(np.concatenate(order), kind="stable"))
