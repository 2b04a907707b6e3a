"""Concealment in time: what a track does whose motion was lost, from the group before and from its neighbours."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.model.clip import ClipScene, GroupMotion

PLACE, LOOKS = slice(0, 3), slice(6, None)
NEAREST = 0.1
"""A neighbour counts no more than one at a third of the mean distance does."""
WILD = 3.0
"""Sum of the magnitudes of weights from which on a plane reaches too far out of its neighbours: their mean is safer."""
RIDGE = 1e-3
"""How much planes through neighbours are kept level, by the spread of these."""


@dataclass(frozen=True)
class ClipConcealer:
    """What becomes of tracks whose motion was lost.

    Attributes:
        name: What it is called.
        shown: Whether they are drawn at all; else they are left out until the next group.
        neighbors: They move as so many of their nearest neighbours whose motion arrived; 0 for none: they stay where
            they were.
        plane: Whether neighbours say so by the plane that fits their motions best (`plane_weights`), not by their mean
            (inverse squared distance).
        momentum: Share of their own last velocity that they go on with, where nobody tells.
        grow: Whether Gaussians whose base was never seen are made up for by those around them.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    name: str
    shown: bool = True
    neighbors: int = 0
    plane: bool = False
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
        ClipConcealer("motion", neighbors=16, plane=True),
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
        offsets: See `GroupMotion.offsets`, float32 (n, C, F).
        concealed: Tracks whose motion was lost, bool (n).
    """

    tracks: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    offsets: np.ndarray
    concealed: np.ndarray


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
    poses = _arrived(motion, frames)
    before = _first_memory(clip) if memory is None else memory.grown(clip.num_gaussians)
    waiting = there & ((born == group) | (before.alive if memory is not None else born < group))
    lost = waiting & ~motion.spoken
    lost[poses.tracks] = False
    who = np.flatnonzero(lost)
    if motion.unchanged:
        poses = _joined(poses, _standing(who, frames, poses.offsets.shape[1]))
    elif len(who):
        guessed = _guessed(clip, poses, who, before, frames, concealer)
        poses = _joined(poses, guessed)
    after = _remembered(poses, clip.num_gaussians, frames, before)
    if not concealer.shown:
        poses = _some(poses, ~poses.concealed)
    return _some(poses, there[poses.tracks]), after


def _first_memory(clip: ClipScene) -> Memory:
    count = clip.num_gaussians
    zero = np.zeros((count, 13), np.float32)
    return Memory(np.zeros(count, bool), zero, zero, np.zeros(count, bool))


def _arrived(motion: GroupMotion, frames: int) -> GroupPoses:
    offsets = np.zeros((len(motion.tracks), motion.offsets.shape[1], frames), np.float32)
    offsets[motion.moving] = motion.offsets
    return GroupPoses(motion.tracks, motion.begins, motion.ends, offsets, np.zeros(len(motion.tracks), bool))


def _standing(who: np.ndarray, frames: int, channels: int) -> GroupPoses:
    """Tracks that stay at their bases."""
    count = len(who)
    offsets = np.zeros((count, channels, frames), np.float32)
    return GroupPoses(who, np.zeros(count, np.int64), np.full(count, frames), offsets, np.zeros(count, bool))


def _guessed(
    clip: ClipScene, arrived: GroupPoses, who: np.ndarray, before: Memory, frames: int, concealer: ClipConcealer,
) -> GroupPoses:  # fmt: skip
    """Poses of tracks whose motion was lost."""
    offsets = np.repeat(before.offsets[who][:, :, None], frames, axis=2)
    whole = (arrived.begins == 0) & (arrived.ends == frames)
    if concealer.neighbors and whole.any():
        # From where they were, unless that is a guess itself: then from their bases, so that errors do not add up.
        known = ~before.concealed[who]
        told = np.flatnonzero(whole & ~before.concealed[arrived.tracks])
        if len(told):
            offsets[known] += _moves_of_neighbors(clip, arrived, told, who[known], before.offsets, concealer)
        bases, told = np.zeros_like(before.offsets), np.flatnonzero(whole)
        offsets[~known] = _moves_of_neighbors(clip, arrived, told, who[~known], bases, concealer)
    elif concealer.momentum:
        steps = np.arange(1, frames + 1, dtype=np.float32)
        offsets[:, PLACE] += concealer.momentum * before.velocity[who][:, PLACE, None] * steps
    count = len(who)
    return GroupPoses(who, np.zeros(count, np.int64), np.full(count, frames), offsets, np.ones(count, bool))


def _moves_of_neighbors(
    clip: ClipScene, arrived: GroupPoses, told: np.ndarray, who: np.ndarray, since: np.ndarray,
    concealer: ClipConcealer,
) -> np.ndarray:  # fmt: skip
    """How the nearest of the tracks that are told about differ from offsets, float32 (T, C): (n, C, F) for `who`."""
    places = clip.tracks.splats.means.numpy() + since[:, PLACE]
    mine = arrived.tracks[told]
    changes = arrived.offsets[told] - since[mine][:, :, None]
    count = min(concealer.neighbors, len(told))
    moves = np.zeros((len(who), *changes.shape[1:]), np.float32)
    if not len(who):
        return moves
    _, near = cKDTree(places[mine]).query(places[who], k=count, workers=-1)
    near = near.reshape(len(who), count)
    weigh = plane_weights if concealer.plane else distance_weights
    weights = weigh(places[mine][near] - places[who][:, None])
    low, high = changes[near[:, 0]][:, LOOKS], changes[near[:, 0]][:, LOOKS]
    for column in range(count):
        change = changes[near[:, column]]
        moves += weights[:, column, None, None] * change
        low, high = np.minimum(low, change[:, LOOKS]), np.maximum(high, change[:, LOOKS])
    moves[:, LOOKS] = moves[:, LOOKS].clip(low, high)  # none grows, shines or reddens more than all around it
    return moves


def distance_weights(offsets: np.ndarray) -> np.ndarray:
    """Weights by inverse squared distance (Shepard, 1968); as `plane_weights`."""
    return _closeness((offsets.astype(np.float64) ** 2).sum(axis=2))[0].astype(np.float32)


def _closeness(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights by inverse squared distance that add up to one, (n, k), and the mean squared distance, (n, 1)."""
    scale = square.mean(axis=1, keepdims=True) + 1e-30
    near = 1 / (square / scale + NEAREST)
    return near / near.sum(axis=1, keepdims=True), scale


def plane_weights(offsets: np.ndarray) -> np.ndarray:
    """Weights that give a smooth motion's value here from its neighbours': of the plane that fits them best.

    What turns or grows as a whole moves as a linear function of place, of which a weighted mean of neighbours on one
    side is wrong and a plane is right. Near neighbours count more, by inverse squared distance.

    Args:
        offsets: Where neighbours are from here, (n, k, 3).

    Returns:
        float32 (n, k); each row adds up to one.
    """
    offsets = offsets.astype(np.float64)
    near, scale = _closeness((offsets**2).sum(axis=2))
    offsets /= np.sqrt(scale)[:, :, None]
    middle = np.einsum("nk,nka->na", near, offsets)
    apart = offsets - middle[:, None]
    spread = np.einsum("nk,nka,nkb->nab", near, apart, apart)
    spread += (RIDGE * np.trace(spread, axis1=1, axis2=2) + 1e-12)[:, None, None] * np.eye(3)
    slope = np.linalg.solve(spread, middle[:, :, None])
    weights = near * (1 - np.einsum("nka,na->nk", apart, slope[:, :, 0]))
    wild = np.abs(weights).sum(axis=1) > WILD
    weights[wild] = near[wild]
    return weights.astype(np.float32)


def _remembered(poses: GroupPoses, count: int, frames: int, before: Memory) -> Memory:
    """What is known after a group; places of those that are not there any more stay where they were."""
    alive, concealed = np.zeros(count, bool), np.zeros(count, bool)
    offsets, velocity = before.offsets.copy(), np.zeros_like(before.velocity)
    last = poses.ends == frames
    rows = poses.tracks[last]
    alive[rows], concealed[rows] = True, poses.concealed[last]
    offsets[rows] = poses.offsets[last][:, :, -1]
    if frames > 1:
        velocity[rows] = poses.offsets[last][:, :, -1] - poses.offsets[last][:, :, -2]
    return Memory(alive, offsets, velocity, concealed)


def _joined(first: GroupPoses, second: GroupPoses) -> GroupPoses:
    order = np.argsort(np.concatenate([first.tracks, second.tracks]), kind="stable")
    return GroupPoses(
        **{name: np.concatenate([values, getattr(second, name)])[order] for name, values in vars(first).items()}
    )


def _some(poses: GroupPoses, index: np.ndarray) -> GroupPoses:
    if index.all():
        return poses
    return GroupPoses(**{name: values[index] for name, values in vars(poses).items()})
