"""What a group's tracks do, relative to their bases, found while its frames come: little is left for the last one."""

import numpy as np

from splatwire.codec.schemas.gaussians.side_info import SideInfo as BaseInfo
from splatwire.codec.schemas.tracks.known_tracks import KnownTracks
from splatwire.codec.schemas.tracks.layout import MAX_COEFFICIENT, MAX_QUANTISED
from splatwire.codec.schemas.tracks.motion_coder import DEAD
from splatwire.codec.schemas.tracks.trajectories import Targets, Trajectories, add_frames

WIDEST_TURN = 2.0
"""Tangent of a quarter of the largest rotation from a base, about 254 degrees: what turned further begins anew."""
LIMITS = np.array([MAX_QUANTISED / 2, MAX_COEFFICIENT / 2, WIDEST_TURN, (32 + DEAD) / 64])
"""Most steps, largest coefficient and turn; least part of a step that is told."""
SPARE = 8
"""Room for one in so many tracks that come after the first look."""


class Fitting:
    """Targets of the tracks of a group.

    Args:
        keys: Names of those that there are by now, in the order of the group, int64 (n).
        known: Tracks that were born in groups before.
        info: Side information of their bases.
        frames: Frames of the group.
        threads: Threads to use, which changes no bit; None for one for each processor.

    Attributes:
        numbers: The base of each, -1 where there is none, int64 (n).
    """

    def __init__(
        self, keys: np.ndarray, known: KnownTracks, info: BaseInfo, frames: int, threads: int | None
    ) -> None:  # fmt: skip
        self._keys, self._known, self._info, self._threads = keys.copy(), known, info, threads
        self.numbers, self._end = known.numbers_of(keys), 0
        self._targets = Targets.zero(len(keys) + len(keys) // SPARE, frames)

    def fits(self, keys: np.ndarray, frames: int) -> bool:
        """Whether these are the tracks of a group, and some that came later."""
        room, last = self._targets.coefficients.shape[0], self._targets.coefficients.shape[2]
        return last == frames and len(keys) <= room and np.array_equal(keys[: len(self._keys)], self._keys)

    def look(self, moves: Trajectories, end: int) -> None:
        """Takes the frames up to one, of all of the group's of which others may lack."""
        some = slice(len(self._keys))
        self._add(self._targets.select(some), moves.select(some), self.numbers, self._end, end)
        self._end = end

    def finish(self, keys: np.ndarray, moves: Trajectories, stay: np.ndarray) -> Targets:
        """Targets of all that have a base, once all frames were looked at.

        Args:
            keys: All tracks of the group, see `fits`.
            moves: What they do.
            stay: Which of them are there in all frames: of others it may be known only now where they are, bool (n).
        """
        self.numbers = np.concatenate([self.numbers, self._known.numbers_of(keys[len(self._keys) :])])
        again, found = np.flatnonzero(~stay), self._targets.select(slice(len(keys)))
        others = Targets.zero(len(again), moves.num_frames)
        self._add(others, moves.select(again), self.numbers[again], 0, moves.num_frames)
        found.put(again, others)
        return found

    def _add(self, some: Targets, moves: Trajectories, numbers: np.ndarray, begin: int, end: int) -> None:
        """Adds frames to what some tracks do."""
        fit(some, moves, self._known, self._info, numbers, (begin, end), self._threads)


def fit(
    found: Targets, moves: Trajectories, known: KnownTracks, info: BaseInfo, numbers: np.ndarray,
    frames: tuple[int, int], threads: int | None,
) -> None:  # fmt: skip
    """Adds frames, from one to another, to what tracks do; of those whose number is below 0 nothing is said."""
    add_frames(found, moves, known.bases, numbers, *frames, info.unit, info.size_log, threads)


def judged(
    largest: np.ndarray, turns: np.ndarray, shifts: np.ndarray, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tracks that went further than their bases allow, and those that move, bool (n).

    Args:
        largest: See `Targets`, float64 (n, C).
        turns: See there, float64 (n).
        shifts: log2 of the steps of all tracks, int64 (T, C).
        numbers: Which of these each is, int64 (n).
    """
    from splatwire.codec.schemas.tracks import _target_kernels as kernels

    far, moving = np.zeros((2, len(numbers)), bool)
    kernels.judge(largest, turns, shifts, numbers, LIMITS, far, moving)
    return far, moving
