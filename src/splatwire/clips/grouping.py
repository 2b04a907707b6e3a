"""Where tracks go in a group of frames while they are not there: with those around them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from splatwire.clips.neighbors import smooth_weights
from splatwire.scene.splats import Splats

NUM_AROUND = 40
"""Tracks that say where another goes while it is not there."""
ALIKE = 0.25
"""Part of its squared motion by which a track may differ from those around it, and yet goes where they go."""
SAMPLE = 512
"""Tracks that say whether most move as those around them."""
MORE_AROUND = 16
"""As many more are looked for while nobody knows who of them will go."""
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


@dataclass(frozen=True, eq=False)
class Around:
    """Tracks and who is near to them in a frame.

    Attributes:
        who: They, int64 (n).
        near: Rows of the nearest of others, nearest first, int64 (n, k).
        weights: How much each of the nearest `NUM_AROUND` of these counts, float32 (n, `NUM_AROUND` or fewer).
    """

    who: np.ndarray
    near: np.ndarray
    weights: np.ndarray

    @staticmethod
    def weighed(places: np.ndarray, who: np.ndarray, near: np.ndarray) -> "Around":
        """The same, by all places in the frame, (T, 3)."""
        return Around(who, near, smooth_weights(places[near[:, :NUM_AROUND]] - places[who, None]))

    def only(self, there: np.ndarray, places: np.ndarray) -> "list[Around]":
        """The nearest `NUM_AROUND` of those that are among some, bool (T); of tracks for which there are so many."""
        known = there[self.near]
        same, enough = known[:, :NUM_AROUND].all(axis=1), known.sum(axis=1) >= NUM_AROUND
        other = enough & ~same
        first = np.argsort(~known[other], axis=1, kind="stable")[:, :NUM_AROUND]
        return [
            Around(self.who[same], self.near[same, :NUM_AROUND], self.weights[same]),
            Around.weighed(places, self.who[other], np.take_along_axis(self.near[other], first, axis=1)),
        ]

    def brings(self, means: np.ndarray, frame: int) -> np.ndarray:
        """Where those around them bring tracks from where they are in the frame, (n, F, 3), by all places (T, F, 3)."""
        own, near = means[self.who, frame, None], means[self.near]
        moved: np.ndarray = own + np.einsum("nk,nkfa->nfa", self.weights, near - near[:, :, frame, None])
        return moved


@dataclass(frozen=True, eq=False)
class Near:
    """Who may be near to others in a frame: rows, int64 (m), and a tree of their places."""

    rows: np.ndarray
    tree: cKDTree

    @staticmethod
    def of(places: np.ndarray, rows: np.ndarray) -> "Near":
        """Some rows of all places, (T, 3); one at least."""
        return Near(rows, cKDTree(places[rows], balanced_tree=False, compact_nodes=False))  # built faster than asked

    def around(self, places: np.ndarray, who: np.ndarray, count: int) -> Around:
        """The nearest `count` of them, or all, to tracks, by all places in that frame, (T, 3)."""
        found = self.tree.query(places[who], k=min(count, len(self.rows)))[1]
        return Around.weighed(places, who, self.rows[found.reshape(len(who), -1)])


def sampled(places: np.ndarray, near: Near) -> Around:
    """Some tracks of those that are in a frame, which say whether most move as those around them; places (T, 3)."""
    some = near.rows[np.linspace(0, len(near.rows) - 1, min(len(near.rows), SAMPLE)).astype(np.int64)]
    found = near.tree.query(places[some], k=min(NUM_AROUND + MORE_AROUND + 1, len(near.rows)))[1]
    return Around.weighed(places, some, near.rows[found.reshape(len(some), -1)[:, 1:]])


def go_along(
    means: np.ndarray, begins: np.ndarray, ends: np.ndarray, known: Mapping[int, Sequence[Around]],
    sample: Around | None,
) -> bool:  # fmt: skip
    """Moves tracks, while they are not there, as those around them move that are there in all frames.

    Only where most of a group move so, and the track itself did while it was there; else it is held.

    A decoder that lost the motion of a track does so, too (`splatwire.clips.guessing`), knowing nothing of when it
    begins: so it finds where the track was born.

    Args:
        means: Places of all tracks over the frames, float32 (n, F, 3); changed in place.
        begins: First frame of each, int64 (n).
        ends: First frame after each, int64 (n).
        known: Who comes or goes with a frame, and some of those around them; what lacks is looked for.
        sample: The same of some tracks in the first frame.

    Returns:
        Whether most move so.
    """
    frames = means.shape[1]
    stays = (begins == 0) & (ends == frames)
    whole = np.flatnonzero(stays)
    if len(whole) <= NUM_AROUND or not _smooth(means, stays, sample):
        return False
    for frame in range(frames):
        late, gone = (begins == frame) & (begins > 0), (ends == frame + 1) & (ends < frames)
        who = np.flatnonzero(late | gone)
        if not len(who):
            continue
        parts = [part for around in known.get(frame, ()) for part in around.only(stays, means[:, frame])]
        lacking = who[~np.isin(who, np.concatenate([who[:0], *(part.who for part in parts)]))]
        if len(lacking):
            near = Near.of(means[:, frame], whole)
            parts += [
                near.around(means[:, frame], some, NUM_AROUND)
                for some in np.array_split(lacking, -(-len(lacking) // AT_ONCE))
            ]
        for part in parts:
            _go(means, begins, ends, part, frame)
    return True


def _go(means: np.ndarray, begins: np.ndarray, ends: np.ndarray, around: Around, frame: int) -> None:
    """Moves some tracks that come or go with a frame."""
    who, numbers, frames = around.who, np.arange(means.shape[1]), means.shape[1]
    late, gone = begins[who] == frame, ends[who] == frame + 1
    late, gone = late & (frame > 0), gone & (frame + 1 < frames)
    own, moved = means[who], around.brings(means, frame)
    there = (begins[who, None] <= numbers) & (numbers < ends[who, None])
    away = late[:, None] & (numbers < frame) | gone[:, None] & (numbers > frame)
    along = away & _alike(own - own[:, None, frame], moved - own[:, None, frame], there)[:, None]
    means[who] = np.where(along[:, :, None], moved, own)


def _smooth(means: np.ndarray, stays: np.ndarray, sample: Around | None) -> bool:
    """Whether most tracks that stay move as those around them: some are asked."""
    parts = [] if sample is None else sample.only(stays, means[:, 0])
    if 2 * sum(int(stays[part.who].sum()) for part in parts) < min(len(means), SAMPLE):
        parts = sampled(means[:, 0], Near.of(means[:, 0], np.flatnonzero(stays))).only(stays, means[:, 0])
    alike = []
    for part in parts:
        own, moved = means[part.who], part.brings(means, 0)
        found = _alike(own - own[:, :1], moved - own[:, :1], np.ones(own.shape[:2], bool))
        alike.append(found[stays[part.who]])
    return bool(np.concatenate(alike).mean() > 0.5)


def _alike(own: np.ndarray, others: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Whether tracks moved as those around them say, (n, F, 3) both, in frames in which they were there, bool (n)."""
    moved, apart = ((np.square(v).sum(axis=2) * there).sum(axis=1) for v in (own, own - others))
    alike: np.ndarray = apart <= ALIKE * moved
    return alike


def first_of(frames: Sequence[NamedFrame], keys: np.ndarray, begins: np.ndarray) -> Splats:
    """Some tracks, by their names, each at its first frame, int64 (n)."""
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
