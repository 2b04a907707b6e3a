"""Chooses how to conceal tracks with lost motion, by testing each method on nearby tracks with received motion."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splatwire.concealment.temporal.motion_prediction import MotionPrediction
from splatwire.concealment.temporal.neighbors import POSITION
from splatwire.concealment.temporal.poses import ConcealmentState, GroupPoses, lifetimes
from splatwire.ops.kd_tree import build_kd_tree
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.sequence_scene import SequenceScene
from splatwire.types.splats import Splats

MAX_TESTS = 1024
"""Maximum number of received tracks that are treated as lost."""
TESTED_DIVISOR = 4
"""At most one received track in `TESTED_DIVISOR` is treated as lost at the same time."""
MIN_TESTS = 16
"""Number of tested tracks around a lost track whose errors are added. With fewer, the first candidate is used."""
MAX_COVERING = 24
"""Number of received Gaussians that are considered at a position."""
FIRST_FACTOR = 0.9
"""Factor on the error of the first candidate, which is thus preferred to others of about the same error."""
HIDE_FACTOR = 0.6
"""Factor on the error of hidden tracks, because enlarged received Gaussians cover a part of them."""
OPACITY_ERROR = 0.5
"""Weight of an error of the opacity relative to an error of the colour."""

Candidate = Callable[[GroupPoses, np.ndarray], MotionPrediction]
"""Function of received poses and of track indices, int64 (n), that estimates the motion of these tracks."""


def select(
    sequence: SequenceScene, group: int, arrived: GroupPoses, tracks: np.ndarray, before: ConcealmentState,
    candidates: Sequence[Candidate], *, grow: bool,
) -> np.ndarray:  # fmt: skip
    """Chooses for each track with lost motion the estimator with the lowest expected error, or hides the track.

    To measure errors, the motion of nearby received tracks is estimated as if it were lost.

    Args:
        sequence: The sequence.
        group: Index of the group of pictures.
        arrived: Tracks with received motion.
        tracks: Indices of the tracks with lost motion, int64 (n).
        before: Concealment state at the end of the previous group of pictures.
        candidates: Estimators of lost motion, at least one. The first is used if too few tracks were received to
            measure errors.
        grow: True if received Gaussians are enlarged to cover hidden tracks; hiding then costs less.

    Returns:
        For each track, the index of its estimator in `candidates`, or `len(candidates)` to hide the track; int64 (n).
    """
    stride = max(-(-len(arrived.tracks) // MAX_TESTS), 1)
    spacing = stride * -(-TESTED_DIVISOR // stride)
    folds = [np.arange(first, len(arrived.tracks), spacing) for first in range(0, spacing, stride)]
    choice, order = np.zeros(len(tracks), np.int64), np.concatenate(folds)
    if len(order) < MIN_TESTS:
        return choice
    errors = np.concatenate(_errors(sequence, group, arrived, folds, candidates))
    errors[:, 0] *= FIRST_FACTOR
    if grow:
        errors[:, -1] *= HIDE_FACTOR
    tested = arrived.tracks[order]
    positions, is_new = sequence.tracks.splats.means + before.offsets[:, POSITION], sequence.tracks.born == group
    for mask in (is_new, ~is_new):  # the first frame of a new track is known, so that its motion is estimated better
        rows, lost = np.flatnonzero(mask[tested]), np.flatnonzero(mask[tracks])
        if len(rows) >= MIN_TESTS and len(lost):
            nearest = build_kd_tree(positions[tested[rows]]).query(positions[tracks[lost]], k=MIN_TESTS)[1]
            choice[lost] = errors[rows[nearest]].sum(axis=1).argmin(axis=1)
    return choice


def _errors(
    sequence: SequenceScene,
    group: int,
    arrived: GroupPoses,
    folds: Sequence[np.ndarray],
    candidates: Sequence[Candidate],
) -> list[np.ndarray]:
    """Measures the error of several estimators of lost motion on tracks with known motion.

    The error of a track is a squared difference of colour and opacity between the true and the estimated picture. It is
    computed at two points, the true and the estimated position of the track, for a few frames. The sum of these squared
    differences is multiplied by the squared scale and the opacity of the track's Gaussian.

    Args:
        sequence: The sequence.
        group: Index of the group of pictures.
        arrived: Tracks with received motion.
        folds: Sets of received tracks; the tracks of a set are treated as lost at the same time.
        candidates: Estimators of lost motion.

    Returns:
        For each fold, the errors of its t tracks, float64 (t, candidates + 1): one column for each estimator. The last
        column contains the errors if the tracks are not drawn.
    """
    # Pictures are compared at the true and at the estimated position, in a few frames; Gaussians are spheres, without
    # depth order.
    frames, splats = len(sequence.timeline.frames_of(group)), sequence.tracks.splats
    untested_masks = [np.ones(len(arrived.tracks), bool) for _ in folds]
    for untested, tested in zip(untested_masks, folds, strict=True):
        untested[tested] = False
    estimates = [
        [candidate(arrived.only(untested), arrived.tracks[tested]) for candidate in candidates]
        for untested, tested in zip(untested_masks, folds, strict=True)
    ]
    errors_of_folds = [np.zeros((len(tested), len(candidates) + 1)) for tested in folds]
    for frame in sorted({frames // 6, frames // 2, 5 * frames // 6}):
        offsets, exists = arrived.at(frame), (arrived.begins <= frame) & (frame < arrived.ends)
        if not exists.any():
            continue
        field = _Field(splats, arrived.tracks, offsets[:, POSITION], exists)
        for errors, tested, untested, fold_estimates in zip(
            errors_of_folds, folds, untested_masks, estimates, strict=True
        ):
            tracks = arrived.tracks[tested]
            begins, ends = lifetimes(sequence, group, tracks)
            true = splats.means[tracks] + offsets[tested, POSITION], exists[tested]
            at_true = field.colour_at(true[0], tested)
            hidden = true[0], np.zeros(len(tested), bool)
            errors[:, -1] += true[1] * field.error(at_true, tested, true, hidden)
            for number, estimate in enumerate(fold_estimates):
                positions = splats.means[tracks] + estimate(frame, offsets[untested])[:, POSITION]
                shown = positions, (begins <= frame) & (frame < ends)
                for local, counts in ((at_true, true[1]), (field.colour_at(positions, tested), shown[1])):
                    errors[:, number] += counts * field.error(local, tested, true, shown)
    return errors_of_folds


class _LocalColour(NamedTuple):
    """Colour and opacity that the Gaussians around a point produce there, for t points.

    Each Gaussian has a weight: its opacity, times the value of its bell curve at the point.

    Attributes:
        points: Positions of the points, (t, 3).
        density: For each point, sum of the weights of the Gaussians around it, (t).
        colour: For each point, weighted sum of the Gaussians' colours, (t, 4): red, green, blue, and a channel that
            makes differences of opacity count as errors. In this channel, every Gaussian has the value
            `OPACITY_ERROR`.
    """

    points: np.ndarray
    density: np.ndarray
    colour: np.ndarray


class _Field:
    """Colour and opacity that the received Gaussians of a frame produce at any position.

    Args:
        splats: Keyframe Gaussians of all tracks.
        tracks: Indices of the received tracks, int64 (m).
        offsets: Position of each of these tracks relative to its keyframe Gaussian, (m, 3).
        exists: Mask of the received tracks that exist in the frame, bool (m).
    """

    def __init__(self, splats: Splats, tracks: np.ndarray, offsets: np.ndarray, exists: np.ndarray) -> None:
        self._squared_scales = (splats.scales[tracks].astype(np.float64) ** 2).mean(axis=1) + 1e-30
        opacity = np.full((len(tracks), 1), OPACITY_ERROR)
        self._colours = np.concatenate([splats.sh[tracks, 0] * DC + 0.5, opacity], axis=1)
        self._opacities = splats.opacities[tracks].astype(np.float64)
        self._rows = np.flatnonzero(exists)
        self._tree = build_kd_tree((splats.means[tracks] + offsets)[self._rows])

    def colour_at(self, points: np.ndarray, tested: np.ndarray) -> "_LocalColour":
        """Computes the colour and opacity that received Gaussians, except the tested ones, produce at given points.

        Args:
            points: Positions of the points, one for each tested track, (t, 3).
            tested: Tracks that are treated as lost for a test, as indices into the received tracks, int64 (t).
        """
        is_untested = np.ones(len(self._squared_scales), bool)
        is_untested[tested] = False
        distance, neighbors = self._tree.query(points, k=min(MAX_COVERING, len(self._rows)))
        neighbors = self._rows[neighbors.reshape(len(points), -1)]
        weights = is_untested[neighbors] * self._opacities[neighbors]
        weights *= np.exp(-(distance.reshape(neighbors.shape) ** 2) / (2 * self._squared_scales[neighbors]))
        return _LocalColour(points, weights.sum(axis=1), np.einsum("nk,nka->na", weights, self._colours[neighbors]))

    def error(
        self, background: "_LocalColour", tested: np.ndarray, *states: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray:
        """Computes the visible error of each of t tracks in one frame, if its estimated state is drawn.

        A track is one Gaussian over time. The error is measured at one point per track. There, colour and opacity with
        the estimated state are compared with colour and opacity with the true state.

        Args:
            background: Points at which the error is measured, one per track, with the colour and opacity of the other
                Gaussians there.
            tested: The t tracks, as indices into the received tracks, int64 (t).
            states: True state and estimated state of the tracks, in this order. Each state has two arrays: positions,
                (t, 3), and the mask of the tracks that exist in the frame, bool (t).

        Returns:
            For each track, squared difference of colour and opacity, times the squared scale and the opacity of the
            track's Gaussian, float64 (t).
        """
        points, density, colour = background
        squared_scales, opacities, drawn = self._squared_scales[tested], self._opacities[tested], []
        for positions, exists in states:
            weight = exists * opacities * np.exp(-((points - positions) ** 2).sum(axis=1) / (2 * squared_scales))
            total = density + weight
            mixed = (colour + weight[:, None] * self._colours[tested]) / np.maximum(total, 1e-12)[:, None]
            drawn.append(mixed * (1 - np.exp(-total))[:, None])
        differences: np.ndarray = ((drawn[0] - drawn[1]) ** 2).sum(axis=1)
        return squared_scales * opacities * differences
