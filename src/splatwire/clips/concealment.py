"""Concealment in time: what a track does whose motion was lost, from the group before and from its neighbours."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.clips.neighbors import OPACITY, PLACE, POSE, Neighbors
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.model.clip import ClipScene, GroupMotion

UNLIKELY = 1e-3
"""Least share of its opacity that is drawn of what may not be born yet."""


@dataclass(frozen=True)
class ClipConcealer:
    """What becomes of tracks whose motion was lost.

    Attributes:
        name: What it is called.
        shown: Whether they are drawn at all; else they are left out until the next group.
        neighbors: They move as so many of their nearest neighbours whose motion arrived; 0 for none: they stay where
            they were.
        smooth: Whether neighbours say so by the quadratic that fits their motions best (`smooth_weights`), not by their
            mean (inverse squared distance).
        momentum: Share of their own last velocity that they go on with, where nobody tells.
        grow: Whether Gaussians whose base was never seen are made up for by those around them.

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


CLIP_CONCEALERS = {
    concealer.name: concealer
    for concealer in (
        ClipConcealer("drop", shown=False, grow=False),
        ClipConcealer("hold"),
        ClipConcealer("extrapolate", momentum=1.0),
        ClipConcealer("neighbors", neighbors=8),
        ClipConcealer("motion", neighbors=40, smooth=True),
    )
}
DEFAULT = "motion"


def clip_concealer(name: str) -> ClipConcealer:
    """A concealer of clips by its name.

    Raises:
        UnknownNameError: If there is none.
    """
    if name not in CLIP_CONCEALERS:
        raise UnknownNameError("concealer of clips", name, CLIP_CONCEALERS)
    return CLIP_CONCEALERS[name]


@dataclass(frozen=True, eq=False)
class GroupPoses:
    """Where every track that is drawn is, in each frame of a group.

    Attributes:
        tracks: They, ascending, int64 (n).
        begins: First frame of each, counted from the group's, int64 (n).
        ends: First frame after each, int64 (n).
        concealed: Tracks whose motion was lost, bool (n).
        at: See `GroupMotion.at`, float32 (n, C) of all.
    """

    tracks: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    concealed: np.ndarray
    at: Callable[[int], np.ndarray]


@dataclass(frozen=True, eq=False)
class Memory:
    """What is known when a group ends.

    Attributes:
        alive: Tracks that are there then, bool (T).
        offsets: How each differs from its base in the last frame, float32 (T, C).
        velocity: Change of that from the frame before, float32 (T, C).
        concealed: Whether that was a guess, bool (T).
    """

    alive: np.ndarray
    offsets: np.ndarray
    velocity: np.ndarray
    concealed: np.ndarray

    def grown(self, num_tracks: int) -> "Memory":
        """The same where more tracks are known of, none of which was there."""
        more = num_tracks - len(self.alive)
        if not more:
            return self
        return Memory(**{
            name: np.concatenate([values, np.zeros((more, *values.shape[1:]), values.dtype)])
            for name, values in vars(self).items()
        })  # fmt: skip


def conceal_group(
    clip: ClipScene, motion: GroupMotion, group: int, there: np.ndarray, memory: Memory | None, concealer: ClipConcealer
) -> tuple[GroupPoses, Memory]:
    """Poses of all tracks in a group.

    Args:
        clip: The clip.
        motion: What arrived of the group's motion.
        group: The group.
        there: Which bases are there, bool (T).
        memory: What was known when the group before ended; None after a seek.
        concealer: What becomes of those whose motion was lost.

    Returns:
        The poses, and what is known when the group ends.
    """
    frames, born = len(clip.timeline.frames_of(group)), clip.tracks.born
    poses = _arrived(motion)
    before = _first_memory(clip) if memory is None else memory.grown(clip.num_gaussians)
    waiting = there & ((born == group) | (before.alive if memory is not None else born < group))
    lost = waiting & ~motion.spoken
    lost[poses.tracks] = False
    who = np.flatnonzero(lost)
    if len(who):
        guess = _standing(who) if motion.unchanged else _guess(clip, poses, who, before, group, concealer)
        poses = _joined(poses, who, frames, guess, concealed=not motion.unchanged)
    after = _remembered(poses, clip.num_gaussians, frames, before)
    if not concealer.shown:
        poses = _some(poses, ~poses.concealed)
    return _some(poses, there[poses.tracks]), after


def _first_memory(clip: ClipScene) -> Memory:
    count = clip.num_gaussians
    zero = np.zeros((count, NUM_CHANNELS), np.float32)
    return Memory(np.zeros(count, bool), zero, zero, np.zeros(count, bool))


def _arrived(motion: GroupMotion) -> GroupPoses:
    return GroupPoses(motion.tracks, motion.begins, motion.ends, np.zeros(len(motion.tracks), bool), motion.at)


_Guess = Callable[[int, np.ndarray], np.ndarray]
"""Of a frame, and of how those that arrived differ from their bases then: how the others do, float32 (n, C)."""


def _standing(who: np.ndarray) -> _Guess:
    """Tracks that stay at their bases."""
    return lambda _frame, _arrived: np.zeros((len(who), NUM_CHANNELS), np.float32)


def _guess(
    clip: ClipScene, arrived: GroupPoses, who: np.ndarray, before: Memory, group: int, concealer: ClipConcealer,
) -> _Guess:  # fmt: skip
    """What tracks do whose motion was lost: what neighbours say, and how they differed from that before."""
    start, frames = before.offsets[who], len(clip.timeline.frames_of(group))
    whole = (arrived.begins == 0) & (arrived.ends == frames)
    if not (concealer.neighbors and whole.any()):
        speed = concealer.momentum * before.velocity[who]
        speed[:, PLACE.stop :] = 0
        return lambda frame, _arrived: start + (frame + 1) * speed if concealer.momentum else start
    told, same, fresh = (
        np.flatnonzero(whole),
        _together(clip.tracks.born, arrived.tracks[whole]),
        clip.tracks.born == group,
    )
    peers, mine = told[same[arrived.tracks[told]]], same[who]
    if len(peers) < concealer.neighbors:
        peers, mine = told, np.zeros(len(who), bool)
    ways = [
        (index, _ask(clip, arrived.tracks, told, origins, who[index], before, concealer), origins)
        for index, origins in (
            (fresh[who] & ~mine, arrived.at(0)[told]),  # a base is where its track is in its first group's first frame
            (~(fresh[who] | mine), before.offsets[arrived.tracks[told]]),
        )
    ]
    alike = _ask(clip, arrived.tracks, peers, None, who[mine], before, concealer)
    own = start[mine] - alike.said(before.offsets[arrived.tracks[peers]])
    own *= _trust(own, clip.tracks.rounding[who[mine]], before.concealed[who[mine]])
    begun = np.log(begun_share(arrived.begins[fresh[arrived.tracks]], frames))

    def at(frame: int, offsets: np.ndarray) -> np.ndarray:
        found = start.copy()
        found[mine] = alike.said(offsets[peers]) + own
        for index, neighbors, origins in ways:
            found[index] += neighbors.said(offsets[told] - origins)
        found[fresh[who], OPACITY] += begun[frame]
        return found

    return at


def _ask(
    clip: ClipScene, tracks: np.ndarray, told: np.ndarray, origins: np.ndarray | None, who: np.ndarray,
    before: Memory, concealer: ClipConcealer,
) -> Neighbors:  # fmt: skip
    """Neighbours of some tracks.

    Args:
        clip: The clip.
        tracks: Of the poses that arrived.
        told: Rows of those that may be asked.
        origins: How they differ from their bases where they are looked for, float32 (m, C); None for not at all: those
            that were born together are neighbours for good, however near others come that bend another way.
        who: Tracks whose neighbours are looked for, where they were when the group before ended.
        before: What was known then.
        concealer: How many neighbours, and how they are weighed.
    """
    places = clip.tracks.splats.means.numpy()
    if origins is not None:
        places = places + before.offsets[:, PLACE]
        places[tracks[told]] = clip.tracks.splats.means.numpy()[tracks[told]] + origins[:, PLACE]
    colours = clip.tracks.splats.sh[:, 0].numpy()
    return Neighbors.of(places, colours, tracks, told, who, concealer.neighbors, smooth=concealer.smooth)


def begun_share(begins: np.ndarray, frames: int) -> np.ndarray:
    """Share of tracks that are there in each frame, float64 (frames); all where there is none.

    When a track is born is in its motion: while that is lost, it is drawn by the odds that it is there.
    """
    share = (begins[:, None] <= np.arange(frames)).mean(axis=0) if len(begins) else np.ones(frames)
    return np.maximum(share, UNLIKELY)


def _together(born: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Tracks that were born in the group that most of those that are told about were, bool (T).

    Offsets of others are from another time on, so that only what these change tells of them.
    """
    return born == np.bincount(born[told]).argmax()


def _trust(own: np.ndarray, rounding: np.ndarray, concealed: np.ndarray) -> np.ndarray:
    """How far tracks go on to differ from what their neighbours say as they did when the group before ended, (n, C).

    Of place and rotation, what is not large beside the steps of the place is rounding; of looks, all is.

    Args:
        own: How they differed, (n, C).
        rounding: Steps of their places, (n).
        concealed: Whether that was a guess, bool (n).
    """
    apart, trust = (own[:, PLACE] ** 2).sum(axis=1), np.zeros_like(own)
    trust[:, POSE] = (apart / (apart + rounding**2 + 1e-30) * ~concealed)[:, None]
    return trust


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


def _joined(first: GroupPoses, who: np.ndarray, frames: int, guess: _Guess, *, concealed: bool) -> GroupPoses:
    """Those that arrived and others, which are there in all frames, ascending by track."""
    tracks = np.concatenate([first.tracks, who])
    order = np.argsort(tracks, kind="stable")

    def at(frame: int) -> np.ndarray:
        offsets = first.at(frame)
        return np.concatenate([offsets, guess(frame, offsets)])[order]

    begins, ends = np.zeros(len(who), np.int64), np.full(len(who), frames)
    guesses = np.concatenate([first.concealed, np.full(len(who), concealed)])
    return GroupPoses(
        tracks[order], np.concatenate([first.begins, begins])[order], np.concatenate([first.ends, ends])[order],
        guesses[order], at,
    )  # fmt: skip


def _some(poses: GroupPoses, index: np.ndarray) -> GroupPoses:
    if index.all():
        return poses
    tracks, begins, ends, concealed = (v[index] for v in (poses.tracks, poses.begins, poses.ends, poses.concealed))
    return GroupPoses(tracks, begins, ends, concealed, lambda frame: poses.at(frame)[index])
