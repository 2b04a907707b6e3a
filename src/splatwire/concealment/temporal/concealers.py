"""Concealers of sequences: estimate the lost motion of tracks (Gaussians over time) in a group of pictures (GOP)."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.arguments import checked
from splatwire.concealment.registry import create, find_temporal, register_concealer, temporal_names
from splatwire.concealment.temporal.motion_prediction import MotionPrediction, predict_lost_motion
from splatwire.concealment.temporal.poses import ConcealmentState, GroupPoses
from splatwire.concealment.temporal.selection import select
from splatwire.errors import InvalidValueError
from splatwire.types.sequence_scene import SequenceScene

DEFAULT = "motion"


@dataclass(frozen=True, eq=False)
class LostMotion:
    """Tracks with lost motion in a group of pictures, and the received information for estimating this motion.

    Attributes:
        sequence: The sequence, with the keyframe Gaussians of all tracks.
        group: Index of the group of pictures.
        tracks: Indices of the tracks with lost motion, int64 (n).
        arrived: Tracks with received motion, and their offsets from their keyframe Gaussians in each frame of the
            group.
        before: Offsets and velocities of the tracks at the end of the previous group.
    """

    sequence: SequenceScene
    group: int
    tracks: np.ndarray
    arrived: GroupPoses
    before: ConcealmentState

    @property
    def num_frames(self) -> int:
        """Number of frames of the group."""
        return len(self.sequence.timeline.frames_of(self.group))


@dataclass(frozen=True, eq=False)
class ConcealedMotion:
    """Motion that a concealer estimates for tracks with lost motion, in one group of pictures.

    Attributes:
        at: Function that estimates the motion of the n lost tracks in one frame, float32 (n, C). Its arguments are the
            index of the frame in the group, and the motion of the m received tracks in that frame, float32 (m, C).
            Motion is the difference from the keyframe Gaussian, with the channels of `GroupMotion.at`.
        shown: Mask of the lost tracks that are drawn, bool (n); or False to hide all of them.
    """

    at: MotionPrediction
    shown: bool | np.ndarray = True


@runtime_checkable
class TemporalConcealer(Protocol):
    """Interface of a concealer for sequences: a named function that estimates lost motion.

    Attributes:
        grow: True if received Gaussians are enlarged to cover missing ones near them. A Gaussian is missing if its
            keyframe packet was lost, or if the concealer does not draw its track (the Gaussian over time).
    """

    grow: bool

    @property
    def name(self) -> str:
        """Name of the concealer, as passed to `temporal_concealer`."""

    def __call__(self, lost: LostMotion, /) -> ConcealedMotion:
        """Estimates the lost motion of tracks in one group of pictures.

        A concealer must not return NaN.
        """


@dataclass(frozen=True)
class MotionConcealer:
    """Estimates lost motion of tracks by continuing their last known motion or interpolating neighbours' motion.

    With interpolation, three alternatives are tested on the received tracks around each lost track: move the track like
    its neighbours, keep it at its last position, or hide it. The alternative with the smallest error is used.

    Attributes:
        name: Name of the concealer.
        shown: If False, tracks with lost motion are not drawn until the next group of pictures.
        neighbors: Number of nearest tracks with received motion whose motion is interpolated; 0 to extrapolate.
        smooth: True for a quadratic fit of the neighbours' motion; False for their mean, weighted by inverse squared
            distance.
        momentum: Fraction of the last velocity that a track keeps if no neighbours are used, 0 to 1.
        grow: True if received Gaussians are enlarged to cover missing ones near them. A Gaussian is missing if its
            keyframe packet was lost, or if the concealer does not draw its track (the Gaussian over time).

    Raises:
        InvalidValueError: If a number is out of range.
    """

    name: str
    shown: bool = True
    neighbors: int = 0
    smooth: bool = False
    momentum: float = 0.0
    grow: bool = True

    def __post_init__(self) -> None:
        if self.neighbors < 0 or not 0 <= self.momentum <= 1:
            raise InvalidValueError(f"neighbours are 0 or more, a momentum is 0 to 1: {self}")

    def __call__(self, lost: LostMotion) -> ConcealedMotion:
        """Returns a function that estimates the motion of lost tracks in a frame, and the mask of tracks to draw."""

        def moved(arrived: GroupPoses, tracks: np.ndarray) -> MotionPrediction:
            return predict_lost_motion(
                lost.sequence, arrived, tracks, lost.before, lost.group,
                neighbors=self.neighbors, smooth=self.smooth, momentum=self.momentum,
            )  # fmt: skip

        def held(_arrived: GroupPoses, tracks: np.ndarray) -> MotionPrediction:
            return lambda _frame, _offsets: lost.before.offsets[tracks]

        if not (self.shown and self.neighbors):
            return ConcealedMotion(moved(lost.arrived, lost.tracks), self.shown)
        best = select(lost.sequence, lost.group, lost.arrived, lost.tracks, lost.before, (moved, held), grow=self.grow)
        moves, last = moved(lost.arrived, lost.tracks[best == 0]), lost.before.offsets[lost.tracks]

        def at(frame: int, offsets: np.ndarray) -> np.ndarray:
            offsets_out = last.copy()
            offsets_out[best == 0] = moves(frame, offsets)
            return offsets_out

        return ConcealedMotion(at, best < 2)


BUILT_IN: dict[str, dict[str, Any]] = {
    "drop": {"shown": False, "grow": False},
    "hold": {},
    "extrapolate": {"momentum": 1.0},
    "neighbors": {"neighbors": 8},
    "motion": {"neighbors": 40, "smooth": True},
}
"""Built-in concealers of sequences: options of `MotionConcealer` by name."""


def _register(preset: str) -> None:
    def make(**options: Any) -> MotionConcealer:
        return MotionConcealer(**{"name": preset, **BUILT_IN[preset], **options})

    register_concealer(preset, temporal=True)(make)


for _preset in BUILT_IN:
    _register(_preset)


@checked
def temporal_concealer(name: str, **options: Any) -> TemporalConcealer:
    """Creates a concealer of sequences.

    Args:
        name: One of `temporal_concealer_names()`, or `name:VALUE` for a concealer with a required option.
        options: Options of that concealer; defaults apply to missing ones.

    Raises:
        UnknownNameError: If no concealer of sequences has that name.
        InvalidValueError: If an option is unknown or invalid, or the providing package is broken.
    """
    made: TemporalConcealer = create(name, find_temporal(name.partition(":")[0]), TemporalConcealer, options)
    return made


def temporal_concealer_names() -> tuple[str, ...]:
    """Returns the names of the concealers of sequences without required options, built-in ones first."""
    return temporal_names()
