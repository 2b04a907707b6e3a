"""Whose motion tells how tracks move whose own was lost: the nearest, weighed."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS

PLACE, POSE, SHAPE, COLOUR = slice(0, 3), slice(0, 6), slice(6, 10), slice(10, None)
OPACITY = 9
"""Channels: place; place and rotation; scales and opacity; colour."""
NEAREST = 0.1
"""A neighbour counts no more than one at a third of the mean distance does."""
WILD = 6.0
"""Sum of the magnitudes of weights from which on a fit reaches too far out of its neighbours: their mean is safer."""
RIDGES = np.array([1e-9, *[1e-3] * 3, *[1e-2] * 6])
"""How much a fit through neighbours is kept level and straight, by their mean distance: constant, linear, quadratic."""
COLOUR_RIDGE = 0.1
"""Squared contrast of colours (constants of harmonics) of which a change that grows with it is half believed."""
AT_ONCE = 1 << 15
"""Tracks whose neighbours are looked for together."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Who tells what some tracks do.

    Attributes:
        told: Rows of the poses that arrived which are asked, int64 (m).
        near: Which of them are near to each track, int32 (n, k).
        weights: How much each of these counts, float32 (n, k).
        closeness: How near it is, adds up to one, float32 (n, k).
        contrasts: How their colours differ from each other, so that the sum with changes of colour is the share of its
            own colour by which one changes, float32 (n, k, 3).
        contrast: How the track's colour differs from theirs, float32 (n, 3).
    """

    told: np.ndarray
    near: np.ndarray
    weights: np.ndarray
    closeness: np.ndarray
    contrasts: np.ndarray
    contrast: np.ndarray

    @staticmethod
    def of(
        places: np.ndarray, colours: np.ndarray, tracks: np.ndarray, told: np.ndarray, who: np.ndarray, count: int,
        *, smooth: bool,
    ) -> "Neighbors":  # fmt: skip
        """The nearest of tracks that are told about.

        Args:
            places: Where tracks were last, float32 (T, 3).
            colours: Constants of their bases' harmonics, float32 (T, 3).
            tracks: Track of each row of the poses that arrived, int64.
            told: Rows that may be asked.
            who: Tracks whose neighbours are looked for.
            count: Neighbours of each, at most.
            smooth: See `splatwire.clips.concealers.ClipConcealer`.
        """
        mine, count = tracks[told], min(count, len(told))
        near, contrast = np.zeros((len(who), count), np.int32), np.zeros((len(who), 3), np.float32)
        weights, closeness = np.zeros((2, len(who), count), np.float32)
        contrasts = np.zeros((len(who), count, 3), np.float32)
        tree = cKDTree(places[mine if len(who) else mine[:0]])
        for begin in range(0, len(who), AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            _, found = tree.query(places[who[some]], k=count, workers=-1)
            near[some] = found.reshape(-1, count)
            offsets = (places[mine][near[some]] - places[who[some]][:, None]).astype(np.float64)
            closeness[some] = _closeness((offsets**2).sum(axis=2))[0]
            weights[some] = smooth_weights(offsets) if smooth else closeness[some]
            contrasts[some], contrast[some] = _contrasts(colours[mine][near[some]], colours[who[some]], closeness[some])
        return Neighbors(told, near, weights, closeness, contrasts, contrast)

    def said(self, values: np.ndarray) -> np.ndarray:
        """What the tracks do, float32 (n, C), given what those that are asked do, float32 (m, C)."""
        said = np.zeros((len(self.near), NUM_CHANNELS), np.float32)
        said[:, : COLOUR.start] = self._summed(self.weights, values[:, : COLOUR.start])
        if (shapes := values[:, SHAPE]).any():
            low = high = shapes[self.near[:, 0]]
            for column in self.near[:, 1:].T:
                value = shapes[column]
                low, high = np.minimum(low, value), np.maximum(high, value)
            said[:, SHAPE] = said[:, SHAPE].clip(low, high)  # none grows or shines more than all around it
        if (colours := values[:, COLOUR]).any():
            said[:, COLOUR] = self._summed(self.closeness, colours)
            share = sum(self._summed(self.contrasts[:, :, a], colours[:, a]) for a in range(3))
            said[:, COLOUR] += np.clip(share, -1, 1)[:, None] * self.contrast
        return said

    def _summed(self, weights: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Of what those asked have, (m, ...), the neighbours', weighed (n, k) and added up, (n, ...)."""
        rows = np.arange(len(self.near) + 1) * self.near.shape[1]
        table = csr_array((weights.ravel(), self.near.ravel(), rows), shape=(len(self.near), len(values)))
        return np.asarray(table @ values)


def _contrasts(colours: np.ndarray, own: np.ndarray, closeness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`Neighbors.contrasts` and `Neighbors.contrast`: light that changes brightens what is bright more than the dark.

    Args:
        colours: Of neighbours, (n, k, 3).
        own: Of the tracks, (n, 3).
        closeness: (n, k).
    """
    near = closeness.astype(np.float64)
    mean = np.einsum("nk,nka->na", near, colours)
    apart = colours - mean[:, None]
    square = np.einsum("nk,nka->n", near, apart * apart)
    return near[:, :, None] * apart / (square + COLOUR_RIDGE)[:, None, None], own - mean


def _closeness(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights by inverse squared distance (Shepard, 1968) that add up to one, (n, k); mean squared distance, (n, 1)."""
    scale = square.mean(axis=1, keepdims=True) + 1e-30
    near = 1 / (square / scale + NEAREST)
    return near / near.sum(axis=1, keepdims=True), scale


def smooth_weights(offsets: np.ndarray) -> np.ndarray:
    """Weights that give a smooth motion's value here from its neighbours': of the quadratic that fits them best.

    What turns or grows as a whole moves as a linear function of place, of which a weighted mean of neighbours on one
    side is wrong; what bends is a quadratic one. Near neighbours count more, by inverse squared distance.

    Args:
        offsets: Where neighbours are from here, (n, k, 3).

    Returns:
        float32 (n, k); each row adds up to one.
    """
    offsets = offsets.astype(np.float64)
    near, scale = _closeness((offsets**2).sum(axis=2))
    x, y, z = np.moveaxis(offsets / np.sqrt(scale)[:, :, None], 2, 0)
    terms = np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=2)
    moments = np.einsum("nk,nka,nkb->nab", near, terms, terms) + np.diag(RIDGES)
    here = np.linalg.solve(moments, np.eye(10)[None, :, :1])[:, :, 0]
    weights = near * np.einsum("nka,na->nk", terms, here)
    weights /= weights.sum(axis=1, keepdims=True)
    wild = np.abs(weights).sum(axis=1) > WILD
    weights[wild] = near[wild]
    return weights.astype(np.float32)
