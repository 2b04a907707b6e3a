"""Fits polynomials to the motion of a group's tracks (Gaussians over time), frame by frame."""

import numpy as np

from splatwire.codec.gaussians.side_info import SideInfo as KeyframeInfo
from splatwire.codec.sequence import _target_kernels as kernels
from splatwire.codec.sequence.known_tracks import KnownTracks
from splatwire.codec.sequence.layout import MAX_COEFFICIENT, MAX_QUANTISED
from splatwire.codec.sequence.motion_coder import DEAD_ZONE_WIDENING
from splatwire.codec.sequence.trajectories import MotionCoefficients, Trajectories, add_frames

MAX_ROTATION = 2.0
"""Largest rotation of a track from its keyframe Gaussian, as the tangent of a quarter of the angle: about 254 degrees.
A track that rotates further gets a new keyframe Gaussian.
"""
MOTION_LIMITS = np.array([MAX_QUANTISED / 2, MAX_COEFFICIENT / 2, MAX_ROTATION, (32 + DEAD_ZONE_WIDENING) / 64])
"""Limits of motion: largest coefficient in quantisation steps, largest coefficient, largest rotation (`MAX_ROTATION`),
and smallest coefficient that is coded, in quantisation steps.
"""
SPARE_DIVISOR = 8
"""Spare capacity for tracks that appear after the first call: the number of tracks divided by this value."""


class Fitting:
    """Fits motion coefficients to the trajectories of tracks (Gaussians over time), as frames become available.

    Args:
        keys: Keys (identifiers) of the tracks of the present group that have appeared so far, int64 (n).
        known_tracks: Tracks of earlier groups with their keyframe Gaussians.
        info: Side information whose lattice spacing determines the unit of motion.
        num_frames: Number of frames in the group.
        threads: Number of threads; None for one per processor.

    Attributes:
        track_indices: Index in `known_tracks` of each track, int64 (n); -1 for tracks that are not in `known_tracks`.
    """

    def __init__(
        self, keys: np.ndarray, known_tracks: KnownTracks, info: KeyframeInfo, num_frames: int, threads: int | None
    ) -> None:  # fmt: skip
        self._keys, self._known, self._info, self._threads = keys.copy(), known_tracks, info, threads
        self.track_indices, self._end = known_tracks.indices_of(keys), 0
        self._motion = MotionCoefficients.zero(len(keys) + len(keys) // SPARE_DIVISOR, num_frames)

    def can_continue(self, keys: np.ndarray, num_frames: int) -> bool:
        """True if this fit can be continued for a group of frames with the given tracks and length.

        Args:
            keys: Keys of all tracks of the group. The fit can only be continued if the first of these keys are the keys
                of the fit's tracks, in the same order.
            num_frames: Number of frames in the group.
        """
        capacity, fitted_frames = self._motion.coefficients.shape[0], self._motion.coefficients.shape[2]
        # Tracks that appeared later may follow.
        return (
            fitted_frames == num_frames
            and len(keys) <= capacity
            and np.array_equal(keys[: len(self._keys)], self._keys)
        )

    def add_frames(self, trajectories: Trajectories, end: int) -> None:
        """Continues the fit with all frames before `end` that were not added yet.

        Args:
            trajectories: Trajectories over the whole group.
            end: Number of available frames; frames from `end` on are ignored.
        """
        selection = slice(len(self._keys))
        self._add(self._motion.select(selection), trajectories.select(selection), self.track_indices, self._end, end)
        self._end = end

    def finish(self, keys: np.ndarray, trajectories: Trajectories, full_length: np.ndarray) -> MotionCoefficients:
        """Completes the fit of a group after all frames were added; returns the motion of all tracks.

        Args:
            keys: Keys (identifiers) of all tracks of the group: first the tracks of this fit, then tracks that appeared
                later.
            trajectories: Trajectories of all tracks over the group.
            full_length: Mask of tracks present in all frames, bool (n).
        """
        self.track_indices = np.concatenate([self.track_indices, self._known.indices_of(keys[len(self._keys) :])])
        # Some positions of a track that begins or ends in the group may have been unknown when the frames were added.
        incomplete, motion = np.flatnonzero(~full_length), self._motion.select(slice(len(keys)))
        refitted = MotionCoefficients.zero(len(incomplete), trajectories.num_frames)
        self._add(refitted, trajectories.select(incomplete), self.track_indices[incomplete], 0, trajectories.num_frames)
        motion.put(incomplete, refitted)
        return motion

    def _add(
        self, motion: MotionCoefficients, trajectories: Trajectories, track_indices: np.ndarray, begin: int, end: int
    ) -> None:
        """Adds the motion of tracks (Gaussians over time) in a range of frames to their least-squares fit."""
        fit(motion, trajectories, self._known, self._info, track_indices, (begin, end), self._threads)


def fit(
    motion: MotionCoefficients, trajectories: Trajectories, known_tracks: KnownTracks, info: KeyframeInfo,
    track_indices: np.ndarray, frame_range: tuple[int, int], threads: int | None,
) -> None:  # fmt: skip
    """Continues the least-squares fit of motion polynomials with the motion of tracks in further frames.

    A track is a Gaussian over time.

    Args:
        motion: Polynomial coefficients of the motion of n tracks, changed in place.
        trajectories: Trajectories of the n tracks over the group of frames.
        known_tracks: All tracks that have a keyframe Gaussian so far.
        info: Side information whose lattice spacing determines the unit of motion.
        track_indices: Index in `known_tracks` of each of the n tracks, int64 (n); tracks with a negative index are
            skipped.
        frame_range: Range of frames to add: first frame and end (exclusive).
        threads: Number of threads; None for one per processor.
    """
    add_frames(
        motion,
        trajectories,
        known_tracks.source_keyframes,
        track_indices,
        *frame_range,
        info.lattice_bits,
        info.size_log,
        threads,
    )


def motion_masks(
    largest: np.ndarray, rotations: np.ndarray, shifts: np.ndarray, track_indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Finds which of n tracks (Gaussians over time) move in a group of frames, and which move too far.

    A track that moves too far cannot be coded relative to its keyframe Gaussian, and needs a new keyframe Gaussian. A
    track moves if one of its coefficients is large enough to be coded.

    Args:
        largest: Largest absolute motion coefficient of each track in each channel, in the units of `layout.CHANNELS`,
            float64 (n, channels).
        rotations: tan(angle / 4) of the largest rotation of each track relative to its keyframe Gaussian, float64 (n).
        shifts: log2 of the quantisation step of each channel's motion, for all T known tracks, int64 (T, channels).
        track_indices: Row in `shifts` of each of the n tracks, int64 (n).

    Returns:
        Mask of the tracks that move too far, bool (n); and mask of the tracks that move, bool (n).
    """
    too_far, moving = np.zeros((2, len(track_indices)), bool)
    kernels.find_moving(largest, rotations, shifts, track_indices, MOTION_LIMITS, too_far, moving)
    return too_far, moving
