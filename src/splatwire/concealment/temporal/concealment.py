"""Temporal concealment of a group of pictures (GOP): finds tracks with lost motion and computes poses of all tracks."""

from collections.abc import Callable

import numpy as np

from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.concealment.temporal.concealers import ConcealedMotion, LostMotion, TemporalConcealer
from splatwire.concealment.temporal.motion_prediction import MotionPrediction, no_motion
from splatwire.concealment.temporal.poses import ConcealmentState, GroupPoses, lifetimes
from splatwire.errors import InvalidValueError
from splatwire.types.sequence_scene import GroupMotion, SequenceScene


def conceal_group(
    sequence: SequenceScene, motion: GroupMotion, group: int, received: np.ndarray, state: ConcealmentState | None,
    concealer: TemporalConcealer,
) -> tuple[GroupPoses, GroupPoses, Callable[[], ConcealmentState]]:  # fmt: skip
    """Computes the poses of all tracks in a group of pictures; the concealer estimates lost motion.

    Args:
        sequence: The sequence.
        motion: Received motion of the group.
        group: Index of the group of pictures.
        received: Mask of received keyframe Gaussians, bool (T).
        state: State at the end of the previous group; None after a seek.
        concealer: Estimates lost motion.

    Returns:
        Poses of the drawn tracks; poses of the tracks that the concealer hides; and a function that computes the state
        at the end of the group, for the next call.

    Raises:
        InvalidValueError: If the concealer returns an invalid result.
    """
    frames, arrived = len(sequence.timeline.frames_of(group)), _arrived(motion)
    poses, hidden = arrived, np.zeros(sequence.num_gaussians, bool)
    before = _initial_state(sequence) if state is None else state.extended_to(sequence.num_gaussians)
    lost_tracks = np.flatnonzero(
        _lost_tracks(sequence, motion, group, received, None if state is None else before.alive)
    )
    if len(lost_tracks):
        prediction = no_motion(lost_tracks)
        if not motion.unchanged:
            result = _checked_estimate(concealer, LostMotion(sequence, group, lost_tracks, arrived, before))
            prediction = result.at
            hidden[lost_tracks[~result.shown]] = True
        others = GroupPoses(
            lost_tracks,
            *lifetimes(sequence, group, lost_tracks),
            np.full(len(lost_tracks), not motion.unchanged),
            arrived.at,
        )
        poses = _merge(arrived, others, prediction)
    is_received, is_hidden = received[poses.tracks], hidden[poses.tracks]

    def after() -> ConcealmentState:
        return _next_state(poses, sequence.num_gaussians, frames, before)

    return poses.only(is_received & ~is_hidden), poses.only(is_received & is_hidden), after


def _checked_estimate(concealer: TemporalConcealer, lost: LostMotion) -> ConcealedMotion:
    """Calls a concealer of lost motion, and checks the type, shape and values of its result in each frame."""
    result, shape = concealer(lost), (len(lost.tracks), NUM_CHANNELS)
    if not isinstance(result, ConcealedMotion):
        problem = type(result).__name__
        raise InvalidValueError(f"concealer '{concealer.name}' returned {problem}, not ConcealedMotion")
    shown = np.asarray(result.shown)
    if shown.dtype != np.bool_ or shown.shape not in ((), shape[:1]):
        problem = f"a mask of shape {shown.shape} and type {shown.dtype} for {shape[0]:,} tracks"
        raise InvalidValueError(f"concealer '{concealer.name}' returned {problem}")

    def at(frame: int, arrived: np.ndarray) -> np.ndarray:
        offsets = np.asarray(result.at(frame, arrived))
        if offsets.shape != shape:
            problem = f"motion of shape {offsets.shape} for {shape[0]:,} tracks of {shape[1]} channels"
            raise InvalidValueError(f"concealer '{concealer.name}' returned {problem}")
        if not bool(np.isfinite(offsets).all()):
            raise InvalidValueError(f"concealer '{concealer.name}' returned motion that is not finite")
        return offsets

    return ConcealedMotion(at, np.broadcast_to(shown, shape[:1]))


def _lost_tracks(
    sequence: SequenceScene, motion: GroupMotion, group: int, received: np.ndarray, alive: np.ndarray | None
) -> np.ndarray:
    """Returns the mask of tracks with lost motion in a group of pictures, bool (T).

    These are the tracks that may exist in the group, and whose keyframe Gaussian was received, but not their motion.

    Args:
        sequence: The sequence.
        motion: Received motion of the group.
        group: Index of the group of pictures.
        received: Mask of received keyframe Gaussians, bool (T).
        alive: Mask of tracks that existed at the end of the previous group, bool (T); None after a seek.
    """
    tracks = sequence.tracks
    candidates = tracks.born < group if alive is None else alive
    lost = received & ((tracks.born == group) | candidates) & (tracks.ends > sequence.timeline.frames_of(group).start)
    lost &= ~motion.covered
    lost[motion.tracks] = False
    return lost


def _initial_state(sequence: SequenceScene) -> ConcealmentState:
    count = sequence.num_gaussians
    zero = np.zeros((count, NUM_CHANNELS), np.float32)
    return ConcealmentState(np.zeros(count, bool), zero, zero, np.zeros(count, bool))


def _arrived(motion: GroupMotion) -> GroupPoses:
    return GroupPoses(motion.tracks, motion.begins, motion.ends, np.zeros(len(motion.tracks), bool), motion.at)


def _next_state(poses: GroupPoses, count: int, frames: int, before: ConcealmentState) -> ConcealmentState:
    """Returns the state at the end of a group of pictures, which is needed to conceal the next group.

    Args:
        poses: Poses of the tracks in the group, received or estimated.
        count: Number of all tracks, T.
        frames: Number of frames of the group.
        before: State at the end of the previous group.
    """
    alive, concealed = np.zeros(count, bool), np.zeros(count, bool)
    offsets, velocity = before.offsets.copy(), np.zeros_like(before.velocity)
    last = poses.ends == frames
    rows = poses.tracks[last]
    alive[rows], concealed[rows] = True, poses.concealed[last]
    offsets[rows] = poses.at(frames - 1)[last]
    if frames > 1:
        velocity[rows] = offsets[rows] - poses.at(frames - 2)[last]
    return ConcealmentState(alive, offsets, velocity, concealed)


def _merge(received: GroupPoses, lost: GroupPoses, prediction: MotionPrediction) -> GroupPoses:
    """Combines received and estimated tracks of a group of pictures, sorted by track index.

    Args:
        received: Poses of the received tracks.
        lost: Tracks with lost motion, and the frames in which they exist.
        prediction: Function that estimates the motion of the lost tracks in a frame.
    """
    order = np.argsort(np.concatenate([received.tracks, lost.tracks]), kind="stable")

    def at(frame: int) -> np.ndarray:
        offsets = received.at(frame)
        return np.concatenate([offsets, prediction(frame, offsets)])[order]

    names = ("tracks", "begins", "ends", "concealed")
    values = {name: np.concatenate([getattr(received, name), getattr(lost, name)])[order] for name in names}
    return GroupPoses(**values, at=at)
