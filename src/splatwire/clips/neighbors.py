"""Whose motion tells how tracks move whose own was lost: the nearest, weighed."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS

PLACE, LOOKS = slice(0, 3), slice(6, None)
NEAREST = 0.1
"""A neighbour counts no more than one at a third of the mean distance does."""
WILD = 3.0
"""Sum of the magnitudes of weights from which on a plane reaches too far out of its neighbours: their mean is safer."""
RIDGE = 1e-3
"""How much planes through neighbours are kept level, by the spread of these."""
AT_ONCE = 1 << 15
"""Tracks whose neighbours are looked for together."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Who tells how some tracks move.

    Attributes:
        told: Rows of the poses that arrived which are asked, int64 (m).
        since: From where on they are asked how they moved, float32 (m, C).
        near: Which of them are near to each track, int32 (n, k).
        weights: How much each of these counts, float32 (n, k).
    """

    told: np.ndarray
    since: np.ndarray
    near: np.ndarray
    weights: np.ndarray

    @staticmethod
    def of(
        means: np.ndarray, tracks: np.ndarray, told: np.ndarray, who: np.ndarray, since: np.ndarray, count: int,
        *, plane: bool,
    ) -> "Neighbors":  # fmt: skip
        """The nearest of tracks that are told about.

        Args:
            means: Where tracks are born, float32 (T, 3).
            tracks: Track of each row of the poses that arrived, int64.
            told: Rows that may be asked.
            who: Tracks whose neighbours are looked for.
            since: How all tracks differed from their bases then, float32 (T, C).
            count: Neighbours of each, at most.
            plane: See `splatwire.clips.concealment.ClipConcealer`.
        """
        places, mine, count = means + since[:, PLACE], tracks[told], min(count, len(told))
        near, weights = np.zeros((len(who), count), np.int32), np.zeros((len(who), count), np.float32)
        weigh, tree = plane_weights if plane else distance_weights, cKDTree(places[mine])
        for begin in range(0, len(who), AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            _, found = tree.query(places[who[some]], k=count, workers=-1)
            near[some] = found.reshape(-1, count)
            weights[some] = weigh(places[mine][near[some]] - places[who[some]][:, None])
        return Neighbors(told, since[mine], near, weights)

    def moves(self, offsets: np.ndarray) -> np.ndarray:
        """How the tracks move, float32 (n, C), given the offsets of all that arrived, float32 (arrived, C)."""
        changes, moves = offsets[self.told] - self.since, np.zeros((len(self.near), NUM_CHANNELS), np.float32)
        low = high = changes[self.near[:, 0]][:, LOOKS]
        for column in range(self.near.shape[1]):
            change = changes[self.near[:, column]]
            moves += self.weights[:, column, None] * change
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
