"""Concealment in time: who of a group is there whose motion was lost, and what is known when it ends."""

from collections.abc import Callable

import numpy as np

from splatwire.clips.concealers import ClipConcealer
from splatwire.clips.guessing import Guess, believed, guess, standing
from splatwire.clips.poses import GroupPoses, Memory
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.model.clip import ClipScene, GroupMotion


def conceal_group(
    clip: ClipScene, motion: GroupMotion, group: int, there: np.ndarray, memory: Memory | None, concealer: ClipConcealer
) -> tuple[GroupPoses, Callable[[], Memory]]:
    """Poses of all tracks in a group.

    Args:
        clip: The clip.
        motion: What arrived of the group's motion.
        group: The group.
        there: Which bases are there, bool (T).
        memory: What was known when the group before ended; None after a seek.
        concealer: What becomes of those whose motion was lost.

    Returns:
        The poses, and what finds out what is known when the group ends: no frame of it waits for that.
    """
    frames, arrived = len(clip.timeline.frames_of(group)), _arrived(motion)
    poses = arrived
    before = _first_memory(clip) if memory is None else memory.grown(clip.num_gaussians)
    who = np.flatnonzero(_lost(clip, motion, group, there, None if memory is None else before.alive))
    if len(who):
        does = standing(who) if motion.unchanged else guess(clip, arrived, who, before, group, concealer)
        others = GroupPoses(who, *_lives(clip, group, who), np.full(len(who), not motion.unchanged), arrived.at)
        poses = _joined(arrived, others, does)
    shown = poses
    if not concealer.shown or (concealer.neighbors and len(who) and not believed(clip, arrived, frames)):
        shown = _some(poses, ~poses.concealed)
    return _some(shown, there[shown.tracks]), lambda: _remembered(poses, clip.num_gaussians, frames, before)


def _lost(clip: ClipScene, motion: GroupMotion, group: int, there: np.ndarray, alive: np.ndarray | None) -> np.ndarray:
    """Tracks that may be there in a group of which nothing is said, bool (T); `alive` when the group before ended."""
    tracks = clip.tracks
    known = tracks.born < group if alive is None else alive
    lost = there & ((tracks.born == group) | known) & (tracks.ends > clip.timeline.frames_of(group).start)
    lost &= ~motion.spoken
    lost[motion.tracks] = False
    return lost


def _lives(clip: ClipScene, group: int, who: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First frame of tracks in a group, and first frame after them, as side information tells, int64 (n) each."""
    frames, tracks = clip.timeline.frames_of(group), clip.tracks
    begins = np.where(tracks.born[who] == group, tracks.begins[who], 0)
    return np.minimum(begins, len(frames) - 1), np.minimum(tracks.ends[who] - frames.start, len(frames))


def _first_memory(clip: ClipScene) -> Memory:
    count = clip.num_gaussians
    zero = np.zeros((count, NUM_CHANNELS), np.float32)
    return Memory(np.zeros(count, bool), zero, zero, np.zeros(count, bool))


def _arrived(motion: GroupMotion) -> GroupPoses:
    return GroupPoses(motion.tracks, motion.begins, motion.ends, np.zeros(len(motion.tracks), bool), motion.at)


def _remembered(poses: GroupPoses, count: int, frames: int, before: Memory) -> Memory:
    """What is known after a group; places of those that are not there any more stay where they were."""
    alive, concealed = np.zeros(count, bool), np.zeros(count, bool)
    offsets, velocity = before.offsets.copy(), np.zeros_like(before.velocity)
    last = poses.ends == frames
    rows = poses.tracks[last]
    alive[rows], concealed[rows] = True, poses.concealed[last]
    offsets[rows] = poses.at(frames - 1)[last]
    if frames > 1:
        velocity[rows] = offsets[rows] - poses.at(frames - 2)[last]
    return Memory(alive, offsets, velocity, concealed)


def _joined(first: GroupPoses, others: GroupPoses, does: Guess) -> GroupPoses:
    """Those that arrived and others, which do what is guessed of them, ascending by track."""
    order = np.argsort(np.concatenate([first.tracks, others.tracks]), kind="stable")

    def at(frame: int) -> np.ndarray:
        offsets = first.at(frame)
        return np.concatenate([offsets, does(frame, offsets)])[order]

    names = ("tracks", "begins", "ends", "concealed")
    values = {name: np.concatenate([getattr(first, name), getattr(others, name)])[order] for name in names}
    return GroupPoses(**values, at=at)


def _some(poses: GroupPoses, index: np.ndarray) -> GroupPoses:
    if index.all():
        return poses
    tracks, begins, ends, concealed = (v[index] for v in (poses.tracks, poses.begins, poses.ends, poses.concealed))
    return GroupPoses(tracks, begins, ends, concealed, lambda frame: poses.at(frame)[index])
