"""Frames whose Gaussians have names, gathered into groups of tracks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatwire.clips.neighbors import smooth_weights
from splatwire.codec.schemas.tracks.encoder import TrackGroup
from splatwire.codec.schemas.tracks.trajectories import Trajectories
from splatwire.scene.splats import Splats

NUM_AROUND = 40
"""Tracks that say where another goes while it is not there."""
ALIKE = 0.25
"""Part of its squared motion by which a track may differ from those around it, and yet goes where they go."""
SAMPLE = 512
"""Tracks that say whether most move as those around them."""
AT_ONCE = 1 << 12
"""Tracks that are asked for together."""


@dataclass(frozen=True, eq=False)
class NamedFrame:
    """A frame of which each Gaussian has a name.

    Attributes:
        splats: The Gaussians.
        keys: Name of each, the same in every frame; all different, int64 (M).
    """

    splats: Splats
    keys: np.ndarray


def group_of(frames: Sequence[NamedFrame]) -> TrackGroup:
    """Gathers the tracks of consecutive frames; a name is in frames that follow each other.

    Before and after a track is there it is held as it is at that end, and goes where those around it go.
    """
    keys, where = _rows_of([frame.keys for frame in frames])
    begins, ends = np.full(len(keys), len(frames), np.int64), np.zeros(len(keys), np.int64)
    for number, rows in enumerate(where):
        begins[rows] = np.minimum(begins[rows], number)
        ends[rows] = number + 1
    moves = Trajectories(
        **{
            name: _stacked([_moving(frame.splats, name).numpy() for frame in frames], where, begins, ends)
            for name in ("means", "quats", "scales", "opacities", "colours")
        }
    )
    _go_along(moves.means, begins, ends)

    def first(some: np.ndarray) -> Splats:
        own = _first(frames, keys[some], begins[some])
        return replace(own, means=torch.from_numpy(moves.means[some, 0]))

    return TrackGroup(keys, begins, ends, moves, first)


def _rows_of(names: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """All names, ascending, and which of them those of each frame are; names are numbers that were counted up."""
    least = min((int(some.min()) for some in names if len(some)), default=0)
    most = max((int(some.max()) for some in names if len(some)), default=-1)
    there = np.zeros(most + 1 - least, bool)
    for some in names:
        there[some - least] = True
    row = np.cumsum(there) - 1
    return np.flatnonzero(there) + least, [row[some - least] for some in names]


def _moving(splats: Splats, name: str) -> Tensor:
    values: Tensor = splats.sh[:, 0] if name == "colours" else getattr(splats, name)
    return values


def _stacked(
    values: Sequence[np.ndarray], where: Sequence[np.ndarray], begins: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """One attribute of all tracks over the frames, float32 (n, F, ...)."""
    stacked = np.zeros((len(begins), len(values), *values[0].shape[1:]), np.float32)
    for frame, (some, rows) in enumerate(zip(values, where, strict=True)):
        stacked[rows, frame] = some
    dying, late = np.flatnonzero(ends < len(values)), np.flatnonzero(begins > 0)
    for frame in range(1, len(values)):
        gone = dying[ends[dying] <= frame]
        stacked[gone, frame] = stacked[gone, frame - 1]
    for frame in range(len(values) - 2, -1, -1):
        unborn = late[begins[late] > frame]
        stacked[unborn, frame] = stacked[unborn, frame + 1]
    return stacked


def _go_along(means: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> None:
    """Moves tracks, while they are not there, as those around them move that are there in all frames.

    Only where most of a group move so, and the track itself did while it was there; else it is held.

    A decoder that lost the motion of a track does so, too (`splatwire.clips.guessing`), knowing nothing of when it
    begins: so it finds where the track was born.

    Args:
        means: Places of all tracks over the frames, float32 (n, F, 3); changed in place.
        begins: First frame of each, int64 (n).
        ends: First frame after each, int64 (n).
    """
    frames = means.shape[1]
    whole = np.flatnonzero((begins == 0) & (ends == frames))
    if len(whole) <= NUM_AROUND or not _smooth(means[whole]):
        return
    numbers = np.arange(frames)
    for frame in range(frames):
        late, gone = (begins == frame) & (begins > 0), (ends == frame + 1) & (ends < frames)
        who = np.flatnonzero(late | gone)
        if not len(who):
            continue
        tree = cKDTree(means[whole, frame], balanced_tree=False, compact_nodes=False)  # built faster than it is asked
        for some in np.array_split(who, -(-len(who) // AT_ONCE)):
            own, near = means[some], means[whole[tree.query(means[some, frame], k=NUM_AROUND)[1]]]
            moved = _around(own, near, frame)
            there = (begins[some, None] <= numbers) & (numbers < ends[some, None])
            away = late[some, None] & (numbers < frame) | gone[some, None] & (numbers > frame)
            along = away & _alike(own - own[:, None, frame], moved - own[:, None, frame], there)[:, None]
            means[some] = np.where(along[:, :, None], moved, own)


def _around(own: np.ndarray, near: np.ndarray, frame: int) -> np.ndarray:
    """Where those around them, (n, k, F, 3), bring tracks from where they are in a frame, (n, F, 3)."""
    weights = smooth_weights(near[:, :, frame] - own[:, None, frame])
    moved: np.ndarray = own[:, None, frame] + np.einsum("nk,nkfa->nfa", weights, near - near[:, :, frame, None])
    return moved


def _smooth(means: np.ndarray) -> bool:
    """Whether most tracks move as those around them: some are asked."""
    some = np.linspace(0, len(means) - 1, min(len(means), SAMPLE)).astype(np.int64)
    tree = cKDTree(means[:, 0], balanced_tree=False, compact_nodes=False)
    own, near = means[some], means[tree.query(means[some, 0], k=NUM_AROUND + 1)[1][:, 1:]]
    moved = _around(own, near, 0)
    return bool(_alike(own - own[:, :1], moved - own[:, :1], np.ones(own.shape[:2], bool)).mean() > 0.5)


def _alike(own: np.ndarray, others: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Whether tracks moved as those around them say, (n, F, 3) both, in frames in which they were there, bool (n)."""
    moved, apart = ((np.square(v).sum(axis=2) * there).sum(axis=1) for v in (own, own - others))
    alike: np.ndarray = apart <= ALIKE * moved
    return alike


def _first(frames: Sequence[NamedFrame], keys: np.ndarray, begins: np.ndarray) -> Splats:
    """Some tracks, each at its first frame."""
    parts, order = [], []
    for number, frame in enumerate(frames):
        own = np.flatnonzero(begins == number)
        if len(own) or not number:
            by = np.argsort(frame.keys, kind="stable")
            rows = by[np.searchsorted(frame.keys, keys[own], sorter=by)]
            parts.append(frame.splats.select(torch.from_numpy(rows)))
            order.append(own)
    joined = Splats(**{name: torch.cat([getattr(part, name) for part in parts]) for name in vars(parts[0])})
    return joined.select(torch.from_numpy(np.argsort(np.concatenate(order), kind="stable")))
