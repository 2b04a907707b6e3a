"""Exact nearest neighbours of points in space."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from splatwire.ops.arrays import to_numpy
from splatwire.ops.kd_tree import build_kd_tree

_CHUNK = 1 << 15
_LEAF_SIZE = 32
"""Points per leaf; a third faster than the default for the large k used here."""
_SPARE = 4
"""Extra neighbours per query, so that ties at the distance of the k-th neighbour can be resolved by index."""


class NeighborTree:
    """Search tree for nearest neighbours.

    Neighbours at the same distance are sorted by index.

    Args:
        support: The S points, a numpy array or a torch tensor.
    """

    def __init__(self, support: Float[Any, "S 3"]) -> None:
        points = to_numpy(support).astype(np.float64)
        self.num_points = len(points)
        # Splitting at the middle of a box builds twice as fast as at the median and is no slower to search.
        self._tree = build_kd_tree(points, leafsize=_LEAF_SIZE, balanced_tree=False, compact_nodes=False)

    def query(
        self, queries: Float[Any, "Q 3"], k: int
    ) -> tuple[Int64[np.ndarray, "Q kept"], Float[np.ndarray, "Q kept"]]:
        """Finds the `min(k, S)` points nearest to each query, nearest first.

        Args:
            queries: Query points.
            k: Number of neighbours.

        Returns:
            Indices of the points, and their distances in the dtype of the queries.
        """
        kept = max(0, min(k, self.num_points))
        points_asked = to_numpy(queries)
        index, distance = (
            np.empty((len(points_asked), kept), np.int64),
            np.empty((len(points_asked), kept), points_asked.dtype),
        )
        # if more points than this tie for the last place, the choice among them is deterministic, but arbitrary
        wanted = min(kept + _SPARE, self.num_points)
        if kept and len(points_asked):
            points = points_asked.astype(np.float64)
            for start in range(0, len(points), _CHUNK):
                rows = slice(start, start + _CHUNK)
                far, near = self._tree.query(points[rows], k=np.arange(1, wanted + 1), workers=-1)
                _order_ties(far, near)
                index[rows] = near[:, :kept]
                distance[rows] = far[:, :kept]
        return index, distance


def nearest_neighbors(
    support: Float[Any, "S 3"], queries: Float[Any, "Q 3"], k: int
) -> tuple[Int64[np.ndarray, "Q kept"], Float[np.ndarray, "Q kept"]]:
    """Finds the k nearest support points of each query, nearest first.

    Points at the same distance are sorted by index.

    Args:
        support: Points to choose from.
        queries: Query points.
        k: Number of neighbours. If there are fewer than k points, all S points are returned.

    Returns:
        Indices into `support`, and Euclidean distances.
    """
    return NeighborTree(support).query(queries, k)


def nearest_others(
    tree: NeighborTree, points: Float[Any, "Q 3"], own_indices: Int64[Any, "Q"], k: int
) -> tuple[Int64[np.ndarray, "Q kept"], Float[np.ndarray, "Q kept"]]:
    """Finds the nearest neighbours of points of the tree, without the points themselves.

    Args:
        tree: Search tree of all S points.
        points: Some points of the tree.
        own_indices: Index in the tree of each of the `points`.
        k: Number of neighbours. If the tree has fewer other points, all of them are returned.

    Returns:
        Indices of the neighbours in the tree; and distances. Both have `kept = min(k, S - 1)` columns.
    """
    index, distance = tree.query(points, k + 1)
    own_indices = to_numpy(own_indices)
    if index.shape[1] == 0:
        return index, distance
    # Usually a point is its own first neighbour, at distance 0; rows with duplicates are corrected separately.
    rows = np.flatnonzero(index[:, 0] != own_indices)
    twins, twin_distance = index[rows], distance[rows]
    itself = twins == own_indices[rows, None]
    itself[:, -1] |= ~itself.any(axis=1)  # more than k duplicates: drop one of them instead
    index, distance = index[:, 1:].copy(), distance[:, 1:].copy()
    index[rows] = twins[~itself].reshape(len(rows), index.shape[1])
    distance[rows] = twin_distance[~itself].reshape(len(rows), index.shape[1])
    return index, distance


def _order_ties(distance: np.ndarray, index: np.ndarray) -> None:
    """Sorts neighbours at the same distance by index, in place.

    Args:
        distance: Distances of each query's neighbours, ascending, (Q, k).
        index: Indices of the neighbours, (Q, k); changed.
    """
    tied = np.flatnonzero((distance[:, 1:] == distance[:, :-1]).any(axis=1))
    if len(tied):
        order = np.lexsort((index[tied], distance[tied]), axis=1)
        index[tied] = np.take_along_axis(index[tied], order, axis=1)
