"""Concealment of lost motion as in the page: interpolated motion, or no lost tracks if motion is incoherent."""

import numpy as np
from scipy.spatial import cKDTree

from splatwire.concealment.temporal.concealers import ConcealedMotion, LostMotion
from splatwire.concealment.temporal.extrapolation import extrapolate
from splatwire.concealment.temporal.neighbors import PLACE
from splatwire.concealment.temporal.poses import GroupPoses
from splatwire.types.sequence_scene import SequenceScene

NUM_NEIGHBORS, MAX_TRACKS, STRIDE = 8, 4096, 8
"""Neighbours per tested track, maximum number of tracks considered, and the stride that selects the tested tracks."""
ALIKE = 0.25
"""Maximum squared deviation from the neighbours' mean motion, relative to the track's squared motion."""


class PageMotion:
    """Concealer `motion` of the page; received Gaussians are not enlarged."""

    name, grow = "page", False

    def __call__(self, lost: LostMotion) -> ConcealedMotion:
        """Returns estimated motion of the lost tracks."""
        at = extrapolate(
            lost.sequence, lost.arrived, lost.tracks, lost.before, lost.group, neighbors=40, smooth=True, momentum=0.0
        )
        return ConcealedMotion(at, is_locally_coherent(lost.sequence, lost.arrived, lost.num_frames))


def is_locally_coherent(clip: SequenceScene, arrived: GroupPoses, frames: int) -> bool:
    """Returns True if most received tracks move like their neighbours (tested on a sample)."""
    observed = np.flatnonzero((arrived.begins == 0) & (arrived.ends == frames))
    if len(observed) <= 2 * NUM_NEIGHBORS:
        return True
    observed = observed[:: -(-len(observed) // MAX_TRACKS)]
    first = arrived.at(0)[observed, PLACE]
    places = clip.tracks.splats.means[arrived.tracks[observed]] + first
    tested = np.arange(0, len(observed), STRIDE)
    nearest = cKDTree(places).query(places[tested], k=NUM_NEIGHBORS + 1)[1][:, 1:]
    moved, apart = np.zeros((2, len(tested)))
    for frame in range(1, frames):
        change = (arrived.at(frame)[observed, PLACE] - first).astype(np.float64)
        moved += (change[tested] ** 2).sum(axis=1)
        apart += ((change[tested] - change[nearest].mean(axis=1)) ** 2).sum(axis=1)
    return bool((apart <= ALIKE * moved).mean() > 0.5)
