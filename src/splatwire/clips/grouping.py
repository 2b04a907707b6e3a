"""Where tracks go in a group of frames while they are not there: with those around them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
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
    """Tracks, each in a frame, and who is near to them there.

    Attributes:
        who: They, int64 (n).
        frames: The frame of each, int64 (n).
        near: Rows of the nearest of others, nearest first, int64 (n, k).
        weights: How much each of the nearest `NUM_AROUND` of these counts, float32 (n, `NUM_AROUND` or fewer).
    """

    who: np.ndarray
    frames: np.ndarray
    near: np.ndarray
    weights: np.ndarray

    @staticmethod
    def weighed(means: np.ndarray, who: np.ndarray, frames: np.ndarray, near: np.ndarray) -> "Around":
        """The same, by places of all tracks over the frames, (T, F, 3)."""
        places = means[near[:, :NUM_AROUND], frames[:, None]]
        return Around(who, frames, near, smooth_weights(places - means[who, frames][:, None]))

    @staticmethod
    def joined(parts: "Sequence[Around]") -> "Around":
        """All of some, of each the nearest `NUM_AROUND` or as many as all know; one at least."""
        names, count = ("who", "frames", "near", "weights"), min(part.near.shape[1] for part in parts)
        values = {name: [getattr(part, name) for part in parts] for name in names}
        values["near"] = [near[:, :count] for near in values["near"]]
        return Around(*(np.concatenate(values[name]) for name in names))

    def only(self, there: np.ndarray, means: np.ndarray) -> "Around":
        """The nearest `NUM_AROUND` of those that are among some, bool (T); of tracks for which there are so many."""
        known = there[self.near]
        same, enough = known[:, :NUM_AROUND].all(axis=1), known.sum(axis=1) >= NUM_AROUND
        other = enough & ~same
        first = np.argsort(~known[other], axis=1, kind="stable")[:, :NUM_AROUND]
        near = np.take_along_axis(self.near[other], first, axis=1)
        return Around.joined([
            Around(self.who[same], self.frames[same], self.near[same, :NUM_AROUND], self.weights[same]),
            Around.weighed(means, self.who[other], self.frames[other], near),
        ])  # fmt: skip

    def part(self, some: np.ndarray | slice) -> "Around":
        """Some of the tracks."""
        return Around(self.who[some], self.frames[some], self.near[some], self.weights[some])

    def brings(self, means: np.ndarray) -> np.ndarray:
        """Where those around them bring tracks from where they are in their frames, (n, F, 3)."""
        own, places = means[self.who, self.frames][:, None], means[self.near, self.frames[:, None]]
        moved: np.ndarray = own + np.einsum("nk,nkfa->nfa", self.weights, means[self.near] - places[:, :, None])
        return moved


@dataclass(frozen=True, eq=False)
class Near:
    """Who may be near to others in a frame: which one, rows, int64 (m), and a tree of their places."""

    frame: int
    rows: np.ndarray
    tree: cKDTree

    @staticmethod
    def of(means: np.ndarray, frame: int, rows: np.ndarray) -> "Near":
        """Some rows of all places over the frames, (T, F, 3); one at least."""
        tree = cKDTree(means[rows, frame], balanced_tree=False, compact_nodes=False)  # built faster than it is asked
        return Near(frame, rows, tree)

    def around(self, means: np.ndarray, who: np.ndarray, count: int, begin: int = 0) -> Around:
        """The nearest of them, from the `begin`-th to the `count`-th, to tracks."""
        found = self.tree.query(means[who, self.frame], k=min(count, len(self.rows)))[1].reshape(len(who), -1)
        return Around.weighed(means, who, np.full(len(who), self.frame), self.rows[found[:, begin:]])


def sampled(means: np.ndarray, near: Near) -> Around:
    """Some tracks of those that are in the first frame, which say whether most move as those around them."""
    some = near.rows[np.linspace(0, len(near.rows) - 1, min(len(near.rows), SAMPLE)).astype(np.int64)]
    return near.around(means, some, NUM_AROUND + MORE_AROUND + 1, begin=1)


def go_along(
    means: np.ndarray, begins: np.ndarray, ends: np.ndarray, known: Sequence[Around], sample: Around | None
) -> bool:
    """Moves tracks, while they are not there, as those around them move that are there in all frames.

    Only where most of a group move so, and the track itself did while it was there; else it is held.

    A decoder that lost the motion of a track does so, too (`splatwire.clips.guessing`), knowing nothing of when it
    begins: so it finds where the track was born.

    Args:
        means: Places of all tracks over the frames, float32 (n, F, 3); changed in place.
        begins: First frame of each, int64 (n).
        ends: First frame after each, int64 (n).
        known: Tracks that come or go with a frame, and some of those around them; what lacks is looked for.
        sample: The same of some tracks in the first frame.

    Returns:
        Whether most move so.
    """
    frames = means.shape[1]
    stays = (begins == 0) & (ends == frames)
    whole = np.flatnonzero(stays)
    if len(whole) <= NUM_AROUND or not _smooth(means, stays, sample):
        return False
    parts = [around.only(stays, means) for around in ([Around.joined(known)] if known else [])]
    late, gone = np.flatnonzero(begins > 0), np.flatnonzero(ends < frames)
    wanted = np.union1d(late * frames + begins[late], gone * frames + ends[gone] - 1)
    lacking = wanted[
        ~np.isin(wanted, np.concatenate([wanted[:0], *(part.who * frames + part.frames for part in parts)]))
    ]
    for frame in np.unique(lacking % frames).tolist():
        who, near = lacking[lacking % frames == frame] // frames, Near.of(means, frame, whole)
        some = np.array_split(who, -(-len(who) // AT_ONCE))
        parts += [near.around(means, few, NUM_AROUND) for few in some]
    for part in parts:
        for begin in range(0, len(part.who), AT_ONCE):
            _go(means, begins, ends, part.part(slice(begin, begin + AT_ONCE)))
    return True


def _go(means: np.ndarray, begins: np.ndarray, ends: np.ndarray, around: Around) -> None:
    """Moves some tracks in frames before they come, or after they went."""
    who, at, numbers, frames = around.who, around.frames[:, None], np.arange(means.shape[1]), means.shape[1]
    begin, end, own, moved = begins[who, None], ends[who, None], means[who], around.brings(means)
    here = means[who, around.frames][:, None]
    away = (begin == at) & (numbers < at) | (end == at + 1) & (end < frames) & (numbers > at)
    along = away & _alike(own - here, moved - here, (begin <= numbers) & (numbers < end))[:, None]
    row, frame = np.nonzero(along)
    means[who[row], frame] = moved[row, frame]


def _smooth(means: np.ndarray, stays: np.ndarray, sample: Around | None) -> bool:
    """Whether most tracks that stay move as those around them: some are asked."""
    asked = None if sample is None else sample.part(stays[sample.who]).only(stays, means)
    if asked is None or 2 * len(asked.who) < min(len(means), SAMPLE):
        asked = sampled(means, Near.of(means, 0, np.flatnonzero(stays))).only(stays, means)
    own, moved = means[asked.who], asked.brings(means)
    return bool(_alike(own - own[:, :1], moved - own[:, :1], np.ones(own.shape[:2], bool)).mean() > 0.5)


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
            parts.append(frame.splats.select(rows))
            order.append(own)
    joined = Splats(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})
    return joined.select(np.argsort(np.concatenate(order), kind="stable"))
