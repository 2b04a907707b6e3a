"""What a track does whose motion was lost, from the group before and from its neighbours."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from splatwire.clips.concealers import ClipConcealer
from splatwire.clips.neighbors import OPACITY, PLACE, POSE, Neighbors
from splatwire.clips.poses import GroupPoses, Memory
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.model.clip import ClipScene

UNLIKELY = 1e-3
"""Least share of its opacity that is drawn of what may not be born yet."""
NUM_AROUND, MOST_AROUND, ASKED = 8, 4096, 8
"""Neighbours that say whether tracks move as those around them; of so many tracks; every so manieth is asked."""
ALIKE = 0.25
"""Part of its squared motion by which a track may differ from them."""

Guess = Callable[[int, np.ndarray], np.ndarray]
"""Of a frame, and of how those that arrived differ from their bases then: how the others do, float32 (n, C)."""


def standing(who: np.ndarray) -> Guess:
    """Tracks that stay at their bases."""
    return lambda _frame, _arrived: np.zeros((len(who), NUM_CHANNELS), np.float32)


def guess(
    clip: ClipScene, arrived: GroupPoses, who: np.ndarray, before: Memory, group: int, concealer: ClipConcealer,
) -> Guess:  # fmt: skip
    """What tracks do whose motion was lost: what neighbours say, and how they differed from that before.

    Args:
        clip: The clip.
        arrived: Tracks whose motion arrived.
        who: The others, int64 (n).
        before: What was known when the group before ended.
        group: The group.
        concealer: How many neighbours tell, and how.
    """
    start, frames = before.offsets[who], len(clip.timeline.frames_of(group))
    whole = (arrived.begins == 0) & (arrived.ends == frames)
    if not (concealer.neighbors and whole.any()):
        speed = concealer.momentum * before.velocity[who]
        speed[:, PLACE.stop :] = 0
        return lambda frame, _arrived: start + (frame + 1) * speed if concealer.momentum else start
    told, fresh = np.flatnonzero(whole), clip.tracks.born == group
    same = _together(clip.tracks.born, arrived.tracks[told])
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
    untold = fresh & (clip.tracks.begins == 0)
    begun = np.log(begun_share(arrived.begins[untold[arrived.tracks]], frames))

    def at(frame: int, offsets: np.ndarray) -> np.ndarray:
        found = start.copy()
        found[mine] = alike.said(offsets[peers]) + own
        for index, neighbors, origins in ways:
            found[index] += neighbors.said(offsets[told] - origins)
        found[untold[who], OPACITY] += begun[frame]
        return found

    return at


def believed(clip: ClipScene, arrived: GroupPoses, frames: int) -> bool:
    """Whether most tracks move as those around them: of those that arrived some are asked.

    Where they do not, as where frames were matched that have little in common, a guess is worse than nothing.
    """
    told = np.flatnonzero((arrived.begins == 0) & (arrived.ends == frames))
    if len(told) <= 2 * NUM_AROUND:
        return True
    told = told[:: -(-len(told) // MOST_AROUND)]
    first = arrived.at(0)[told, PLACE]
    places = clip.tracks.splats.means[arrived.tracks[told]] + first
    asked = np.arange(0, len(told), ASKED)
    near = cKDTree(places).query(places[asked], k=NUM_AROUND + 1)[1][:, 1:]
    moved, apart = np.zeros((2, len(asked)))
    for frame in range(1, frames):
        change = (arrived.at(frame)[told, PLACE] - first).astype(np.float64)
        moved += (change[asked] ** 2).sum(axis=1)
        apart += ((change[asked] - change[near].mean(axis=1)) ** 2).sum(axis=1)
    return bool((apart <= ALIKE * moved).mean() > 0.5)


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
    places = clip.tracks.splats.means
    if origins is not None:
        places = places + before.offsets[:, PLACE]
        places[tracks[told]] = clip.tracks.splats.means[tracks[told]] + origins[:, PLACE]
    colours = clip.tracks.splats.sh[:, 0]
    return Neighbors.of(places, colours, tracks, told, who, concealer.neighbors, smooth=concealer.smooth)


def begun_share(begins: np.ndarray, frames: int) -> np.ndarray:
    """Share of tracks that are there in each frame, float64 (frames); all where there is none.

    When a track is born is in its motion: while that is lost, and side information does not tell, it is drawn by the
    odds that it is there.
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
