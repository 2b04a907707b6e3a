"""Weighted nearest neighbours: estimates the motion of lost tracks from the motion of received tracks."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.concealment.temporal import _neighbor_kernels as kernels
from splatwire.ops.kd_tree import build_kd_tree

POSITION, POSE, SHAPE, COLOUR = slice(0, 3), slice(0, 6), slice(6, 10), slice(10, None)
OPACITY = 9
"""Index of the opacity channel of motion; the slices above select the channels of position; position and rotation;
scales and opacity; colour."""
DISTANCE_FLOOR = 0.1
"""Value added to squared distances, in units of the mean squared distance. No weight exceeds that of a neighbour at
about a third of the mean distance.
"""
MAX_WEIGHT_SUM = 6.0
"""Maximum sum of absolute weights of a quadratic fit. Above this sum the fit extrapolates too far, and the weighted
mean is used instead."""
RIDGES = np.array([1e-9, *[1e-3] * 3, *[1e-2] * 6])
"""Ridge regularisation of the fit's constant, linear and quadratic terms, in units of the mean distance."""
COLOUR_RIDGE = 0.1
"""Ridge of the regression of colour change on colour contrast; the slope is halved at this squared contrast of the
constant harmonic coefficients."""
AT_ONCE = 1 << 15
"""Number of tracks per batch of neighbour queries."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Received neighbours of each track with lost motion, and the weights with which its motion is estimated.

    A lost track moves like the weighted mean of its neighbours. Its change of colour is the mean change of the
    neighbours, plus a slope times the difference between its colour and their mean colour. The slope accounts for
    changes of lighting, which affect bright surfaces more than dark ones.

    Attributes:
        observed: Received tracks that may serve as neighbours: indices into the list of received tracks, int64 (m).
        index: Neighbours of each track, as indices into `observed`, int32 (n, k).
        weights: Weight of each neighbour for all channels except colour, float32 (n, k).
        closeness: Weight of each neighbour for the mean colour change, by inverse squared distance, float32 (n, k); the
            weights of a track add up to 1.
        contrasts: Weights for computing the slope, float32 (n, k, 3). The slope is the weighted sum of the neighbours'
            colour changes, over neighbours and colour channels.
        contrast: Difference of the track's colour from the mean colour of its neighbours, float32 (n, 3).
    """

    observed: np.ndarray
    index: np.ndarray
    weights: np.ndarray
    closeness: np.ndarray
    contrasts: np.ndarray
    contrast: np.ndarray

    @staticmethod
    def of(
        positions: np.ndarray, colours: np.ndarray, tracks: np.ndarray, observed: np.ndarray, lost: np.ndarray,
        count: int, *, smooth: bool,
    ) -> "Neighbors":  # fmt: skip
        """Finds the nearest received tracks of each track with lost motion, and their weights.

        Args:
            positions: Last known positions of all tracks, float32 (T, 3).
            colours: Spherical harmonics of degree 0 of the keyframe Gaussians, float32 (T, 3).
            tracks: Indices of the received tracks, int64.
            observed: Received tracks that may serve as neighbours: indices into `tracks`.
            lost: Indices of the tracks with lost motion.
            count: Maximum number of neighbours per track.
            smooth: True to fit a quadratic function to the neighbours, False to compute their weighted mean.
        """
        mine, count = tracks[observed], min(count, len(observed))
        index, contrast = np.zeros((len(lost), count), np.int32), np.zeros((len(lost), 3), np.float32)
        weights, closeness = np.zeros((2, len(lost), count), np.float32)
        contrasts = np.zeros((len(lost), count, 3), np.float32)
        tree = build_kd_tree(positions[mine if len(lost) else mine[:0]])
        for begin in range(0, len(lost), AT_ONCE):
            batch = slice(begin, begin + AT_ONCE)
            _, nearest = tree.query(positions[lost[batch]], k=count, workers=-1)
            index[batch] = nearest.reshape(-1, count)
            offsets = (positions[mine][index[batch]] - positions[lost[batch]][:, None]).astype(np.float64)
            closeness[batch] = _closeness((offsets**2).sum(axis=2))
            weights[batch] = smooth_weights(offsets) if smooth else closeness[batch]
            contrasts[batch], contrast[batch] = _colour_slope(
                colours[mine][index[batch]], colours[lost[batch]], closeness[batch]
            )
        return Neighbors(observed, index, weights, closeness, contrasts, contrast)

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Interpolates values of the lost tracks, float32 (n, C), from values of the neighbours, float32 (m, C)."""
        interpolated = np.zeros((len(self.index), NUM_CHANNELS), np.float32)
        if self.index.size:
            kernels.interpolate(
                self.index, self.weights, self.closeness, self.contrasts, self.contrast, np.ascontiguousarray(values),
                bool(values[:, SHAPE].any()), bool(values[:, COLOUR].any()), np.empty(3, np.float32), interpolated,
            )  # fmt: skip
        return interpolated


def _colour_slope(
    colours: np.ndarray, track_colours: np.ndarray, closeness: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fits the slope of colour change against colour over the neighbours of each lost track, by least squares.

    The colour changes of the neighbours are known only later, frame by frame. The slope is a weighted sum of these
    changes, and this function computes the weights.

    Args:
        colours: Colours of the neighbours, (n, k, 3).
        track_colours: Colours of the tracks, (n, 3).
        closeness: Inverse-distance weights, (n, k).

    Returns:
        Weights of the neighbours' colour changes in the slope, (n, k, 3); and difference of each track's colour from
        the mean colour of its neighbours, (n, 3).
    """
    # a change of lighting brightens bright surfaces more than dark ones
    proximity = closeness.astype(np.float64)
    mean = np.einsum("nk,nka->na", proximity, colours)
    contrasts = colours - mean[:, None]
    square = np.einsum("nk,nka->n", proximity, contrasts * contrasts)
    return proximity[:, :, None] * contrasts / (square + COLOUR_RIDGE)[:, None, None], track_colours - mean


def _closeness(square: np.ndarray) -> np.ndarray:
    """Returns weights by inverse squared distance (Shepard, 1968), (n, k); the k weights of a track add up to 1.

    Args:
        square: Squared distances of the k neighbours of each track, (n, k).
    """
    proximity = 1 / (square / (square.mean(axis=1, keepdims=True) + 1e-30) + DISTANCE_FLOOR)
    weights: np.ndarray = proximity / proximity.sum(axis=1, keepdims=True)
    return weights


def smooth_weights(offsets: np.ndarray) -> np.ndarray:
    """Returns weights with which a value at a query point is interpolated from its k neighbours.

    The weighted sum of the neighbours' values is a regularised quadratic least-squares fit to them, evaluated at the
    query point. If weights of this fit would be too large, the weights depend on the distance only.

    Args:
        offsets: Positions of the neighbours relative to the query point, (n, k, 3).

    Returns:
        Weights, float32 (n, k); the k weights of each query point add up to 1.
    """
    # Rotation and scaling are linear functions of position, bending is quadratic. A weighted mean is wrong for these if
    # all neighbours are on one side.
    weights, count = np.empty(offsets.shape[:2], np.float32), offsets.shape[1]
    scratch = np.empty(count), np.empty((count, len(RIDGES))), np.empty((len(RIDGES),) * 2), np.empty(len(RIDGES))
    kernels.smooth_weights(
        np.ascontiguousarray(offsets, np.float64), RIDGES, DISTANCE_FLOOR, MAX_WEIGHT_SUM, *scratch, weights
    )
    return weights
