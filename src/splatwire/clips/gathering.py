"""Frames whose Gaussians have names, gathered into a group of tracks while they come.

What can be done before a group's last frame is done before: a live viewer waits for the rest.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatwire.clips.grouping import MORE_AROUND, NUM_AROUND, Around, NamedFrame, Near, first_of, go_along, sampled
from splatwire.codec.schemas.tracks.track_group import TrackGroup
from splatwire.codec.schemas.tracks.trajectories import Trajectories
from splatwire.scene.splats import Splats

SPARE = 8
"""Room for one in so many tracks that come after the first frame."""
MOST_EARLY = 1 << 13
"""Tracks that come or go whose neighbours are looked for before the group is there, which takes memory; then after."""


class Gathering:
    """Tracks of consecutive frames; a name is in frames that follow each other.

    Args:
        frames: Frames of the group, at most.
        smooth: Whether it is likely that most tracks move as those around them: then neighbours are looked for early.
    """

    def __init__(self, frames: int, *, smooth: bool = False) -> None:
        self._most, self._early = frames, smooth
        self.frames: list[NamedFrame] = []
        self._keys = self._by = self._begins = self._ends = np.zeros(0, np.int64)
        self._room = 0
        self._values: dict[str, np.ndarray] = {}
        self._around: list[Around] = []
        self._tree: Near | None = None
        self._sample: Around | None = None
        self.smooth = False

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: NamedFrame) -> None:
        """Takes the next frame."""
        number = len(self.frames)
        self.frames.append(frame)
        rows = self._rows_of(frame.keys)
        for name, values in _moving(frame.splats).items():
            self._values[name][rows, number] = values
        self._ends[rows] = number + 1
        if self._early:
            self._look(number)

    def _rows_of(self, keys: np.ndarray) -> np.ndarray:
        """Rows of tracks by their names, with room for those that are new."""
        by, number = self._by, len(self.frames) - 1
        at = np.searchsorted(self._keys, keys, sorter=by)
        known = self._keys[by[np.minimum(at, len(by) - 1)]] == keys if len(by) else np.zeros(len(keys), bool)
        if not known.all():
            more = np.sort(keys[~known])
            self._keys = np.concatenate([self._keys, more])
            self._begins = np.concatenate([self._begins, np.full(len(more), number)])
            self._ends = np.concatenate([self._ends, np.full(len(more), number)])
            self._by = by = np.argsort(self._keys, kind="stable")
            at = np.searchsorted(self._keys, keys, sorter=by)
        if not self._values or len(self._keys) > self._room:
            self._grow(len(self._keys) + len(self._keys) // SPARE)
        return by[at]

    def _grow(self, count: int) -> None:
        """Makes room for so many tracks."""
        self._room = count
        for name, values in _moving(self.frames[-1].splats).items():
            grown = np.zeros((count, self._most, *values.shape[1:]), np.float32)
            if name in self._values:
                grown[: len(self._values[name])] = self._values[name]
            self._values[name] = grown

    def _look(self, number: int) -> None:
        """Looks for the neighbours of those that come with a frame, and of those that went with it."""
        means, count = self._values["means"], NUM_AROUND + MORE_AROUND
        stay = np.flatnonzero((self._begins == 0) & (self._ends == number + 1))
        went = np.flatnonzero(self._ends == number)
        room = MOST_EARLY - sum(len(around.who) for around in self._around)
        if number and self._tree is not None and 0 < len(went) <= room:
            self._around.append(self._tree.around(means, went, count))
        self._tree = None
        if not len(stay) or number == self._most - 1:
            return
        self._tree = Near.of(means, number, stay)
        if not number:
            self._sample = sampled(means, self._tree)
        came = np.flatnonzero(self._begins == number)
        if number and 0 < len(came) <= room - len(went):
            self._around.append(self._tree.around(means, came, count))

    def so_far(self) -> tuple[np.ndarray, Trajectories, int]:
        """Tracks by now, what they do over all frames of the group, and how many of these are there."""
        count = len(self._keys)
        return self._keys, Trajectories(**{name: some[:count] for name, some in self._values.items()}), len(self.frames)

    def group(self) -> TrackGroup:
        """The group of all frames so far.

        Before and after a track is there it is held as it is at that end, and goes where those around it go.
        """
        count, number = len(self._keys), len(self.frames)
        values = {name: values[:count, :number] for name, values in self._values.items()}
        for some in values.values():
            _held(some, self._begins, self._ends)
        self.smooth = go_along(values["means"], self._begins, self._ends, self._around, self._sample)
        keys, begins, ends, frames = self._keys, self._begins, self._ends, self.frames
        if not np.array_equal(self._by, np.arange(count)):
            keys, begins, ends = keys[self._by], begins[self._by], ends[self._by]
            values = {name: some[self._by] for name, some in values.items()}
        values = {name: np.ascontiguousarray(some) for name, some in values.items()}

        def first(some: np.ndarray) -> Splats:
            own = first_of(frames, keys[some], begins[some])
            return replace(own, means=values["means"][some, 0])

        return TrackGroup(keys, begins, ends, Trajectories(**values), first)


def group_of(frames: Sequence[NamedFrame]) -> TrackGroup:
    """Gathers the tracks of consecutive frames, see `Gathering`."""
    gathering = Gathering(len(frames))
    for frame in frames:
        gathering.add(frame)
    return gathering.group()


def _moving(splats: Splats) -> dict[str, np.ndarray]:
    """What can change of Gaussians."""
    names = ("means", "quats", "scales", "opacities")
    return {**{name: getattr(splats, name) for name in names}, "colours": splats.sh[:, 0]}


def _held(values: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> None:
    """Holds one attribute of tracks, (n, F, ...), before they are there and after."""
    frames = values.shape[1]
    dying, late = np.flatnonzero(ends < frames), np.flatnonzero(begins > 0)
    for frame in range(1, frames):
        gone = dying[ends[dying] <= frame]
        values[gone, frame] = values[gone, frame - 1]
    for frame in range(frames - 2, -1, -1):
        unborn = late[begins[late] > frame]
        values[unborn, frame] = values[unborn, frame + 1]
