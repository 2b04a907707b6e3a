"""Estimates lost motion of tracks from the previous group of pictures and from neighbouring tracks."""

from collections.abc import Callable

import numpy as np

from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.concealment.temporal.neighbors import OPACITY, POSE, POSITION, Neighbors
from splatwire.concealment.temporal.poses import ConcealmentState, GroupPoses
from splatwire.types.sequence_scene import SequenceScene

UNLIKELY = 1e-3
"""Minimum opacity factor of a track whose first frame was lost, so that it may not exist yet."""
MotionPrediction = Callable[[int, np.ndarray], np.ndarray]
"""Function of a frame and of the received tracks' offsets that returns offsets of the lost tracks, float32 (n, C)."""


def no_motion(lost_tracks: np.ndarray) -> MotionPrediction:
    """Returns a function that estimates no motion in any frame: lost tracks stay at their keyframe Gaussians."""
    return lambda _frame, _arrived: np.zeros((len(lost_tracks), NUM_CHANNELS), np.float32)


def predict_lost_motion(
    sequence: SequenceScene, arrived: GroupPoses, lost_tracks: np.ndarray, before: ConcealmentState, group: int,
    *, neighbors: int, smooth: bool, momentum: float,
) -> MotionPrediction:  # fmt: skip
    """Predicts the motion of lost tracks from neighbouring tracks with received motion, or from their own last motion.

    Args:
        sequence: The sequence.
        arrived: Tracks with received motion.
        lost_tracks: Indices of the tracks with lost motion, int64 (n).
        before: Concealment state at the end of the previous group of pictures.
        group: Index of the group of pictures.
        neighbors: Number of nearest tracks with received motion to interpolate; 0 keeps the last position.
        smooth: True for a quadratic fit of the neighbours' motion, False for a weighted mean.
        momentum: Fraction of the last velocity that a track keeps if no neighbours are used, 0 to 1.

    Returns:
        Function that estimates the motion of the lost tracks in one frame (see `ConcealedMotion.at`).
    """
    start, frames = before.offsets[lost_tracks], len(sequence.timeline.frames_of(group))
    whole = (arrived.begins == 0) & (arrived.ends == frames)
    if not (neighbors and whole.any()):
        speed = momentum * before.velocity[lost_tracks]
        speed[:, POSITION.stop :] = 0
        return lambda frame, _arrived: start + (frame + 1) * speed if momentum else start
    observed, fresh = np.flatnonzero(whole), sequence.tracks.born == group
    same = _most_common_birth(sequence.tracks.born, arrived.tracks[observed])
    peers, mine = observed[same[arrived.tracks[observed]]], same[lost_tracks]
    if len(peers) < neighbors:
        peers, mine = observed, np.zeros(len(lost_tracks), bool)

    def query(rows: np.ndarray, reference_offsets: np.ndarray | None, queries: np.ndarray) -> Neighbors:
        return _query_neighbors(
            sequence, arrived.tracks, rows, reference_offsets, queries, before, neighbors, smooth=smooth
        )

    estimates = [
        (index, query(observed, reference_offsets, lost_tracks[index]), reference_offsets)
        for index, reference_offsets in (
            (fresh[lost_tracks] & ~mine, arrived.at(0)[observed]),  # keyframe positions are those of the first frame
            (~(fresh[lost_tracks] | mine), before.offsets[arrived.tracks[observed]]),
        )
    ]
    same_start = query(peers, None, lost_tracks[mine])
    own_motion = start[mine] - same_start.interpolate(before.offsets[arrived.tracks[peers]])
    own_motion *= _kept_deviation(
        own_motion, sequence.tracks.rounding[lost_tracks[mine]], before.concealed[lost_tracks[mine]]
    )
    starts_unknown = fresh & (sequence.tracks.begins == 0)
    begun = np.log(started_share(arrived.begins[starts_unknown[arrived.tracks]], frames))

    def at(frame: int, offsets: np.ndarray) -> np.ndarray:
        estimate = start.copy()
        estimate[mine] = same_start.interpolate(offsets[peers]) + own_motion
        for index, others, reference_offsets in estimates:
            estimate[index] += others.interpolate(offsets[observed] - reference_offsets)
        estimate[starts_unknown[lost_tracks], OPACITY] += begun[frame]
        return estimate

    return at


def _query_neighbors(
    sequence: SequenceScene, tracks: np.ndarray, observed: np.ndarray, reference_offsets: np.ndarray | None,
    lost_tracks: np.ndarray, before: ConcealmentState, count: int, *, smooth: bool,
) -> Neighbors:  # fmt: skip
    """Finds, for each track with lost motion, its nearest tracks with received motion.

    Args:
        sequence: The sequence.
        tracks: Indices of all tracks with received motion.
        observed: Indices into `tracks` of the m tracks that may serve as neighbours.
        reference_offsets: Offsets of the m tracks from their keyframe Gaussians at the start of the group, float32 (m,
            C). If given, the neighbours are the nearest tracks at the start of the group. If None, they are the tracks
            with the nearest keyframe Gaussians.
        lost_tracks: Indices of the tracks with lost motion.
        before: Concealment state at the end of the previous group.
        count: Maximum number of neighbours per track.
        smooth: True to interpolate with a quadratic fit to the neighbours, False with their weighted mean.
    """
    positions = sequence.tracks.splats.means
    if reference_offsets is not None:
        positions = positions + before.offsets[:, POSITION]
        positions[tracks[observed]] = sequence.tracks.splats.means[tracks[observed]] + reference_offsets[:, POSITION]
    colours = sequence.tracks.splats.sh[:, 0]
    return Neighbors.of(positions, colours, tracks, observed, lost_tracks, count, smooth=smooth)


def started_share(begins: np.ndarray, frames: int) -> np.ndarray:
    """Returns, for each frame of a group of pictures, the share of the received tracks that have begun.

    Args:
        begins: First frame of each received track within the group.
        frames: Number of frames of the group.

    Returns:
        Share for each frame, above 0, float64 (frames).
    """
    # the first frame of a lost track is lost, too
    share = (begins[:, None] <= np.arange(frames)).mean(axis=0) if len(begins) else np.ones(frames)
    return np.maximum(share, UNLIKELY)


def _most_common_birth(born: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Selects all tracks that begin in the group of pictures in which the largest number of received tracks begins.

    Args:
        born: Group in which each track begins, int64 (T).
        observed: Received tracks, as indices into `born`.

    Returns:
        Mask of the selected tracks, bool (T).
    """
    # offsets are relative to the keyframe Gaussian, so those of tracks with different first groups differ in time
    return born == np.bincount(born[observed]).argmax()


def _kept_deviation(deviation: np.ndarray, rounding: np.ndarray, concealed: np.ndarray) -> np.ndarray:
    """Returns the factors that reduce deviations from the neighbours' motion for the next group of pictures.

    If a track deviated from its neighbours' motion at the end of a group, its estimate in the next group keeps this
    deviation, multiplied by the factor. A small deviation gets a small factor, because it is probably a rounding error.
    The factor is 0 for concealed tracks, and for scale, opacity and colour.

    Args:
        deviation: Deviation of each track from its neighbours' motion at the end of the previous group, (n, C).
        rounding: Quantisation step of each track's position, (n).
        concealed: Mask of tracks whose motion in the previous group was only estimated, bool (n).

    Returns:
        Factor for each track and channel, 0 to 1, float (n, C).
    """
    # a small deviation is probably a rounding error; those of scale, opacity and colour are not kept
    squared_deviation, kept = (deviation[:, POSITION] ** 2).sum(axis=1), np.zeros_like(deviation)
    kept[:, POSE] = (squared_deviation / (squared_deviation + rounding**2 + 1e-30) * ~concealed)[:, None]
    return kept
