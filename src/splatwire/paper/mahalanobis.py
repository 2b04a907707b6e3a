"""Exact nearest-neighbour search by Mahalanobis distance; every point has a covariance.

Source: Section 3.4 of the paper (`docs/paper-map.md`).
"""

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.ops.knn import NeighborTree
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode
from splatwire.paper._mahalanobis_kernels import nearest

_BLOCK = 64
"""Number of points per block of `MahalanobisSearch`; a query either searches all points of a block or skips it."""


class MahalanobisSearch:
    """Exact search for the points that are nearest to a query by Mahalanobis distance.

    The distance of the query q from the point k is `sqrt((x_q - x_k)^T diag(size_k)^-2 (x_q - x_k))`.

    Args:
        points: Positions of the points.
        sizes: Extents of the points along the axes, positive.
    """

    # No point is excluded by Euclidean distance, because a large point can be the nearest one from far away. Points
    # of similar size and position share a block. A block is skipped only if none of its points can be among the
    # nearest, so the result is exact.

    def __init__(self, points: Float[Tensor, "S 3"], sizes: Float[Tensor, "S 3"]) -> None:
        positions, extents = points.double().numpy(), sizes.double().numpy()
        self._tree = NeighborTree(points)
        self._order = _local_order(positions, extents)
        self._positions, self._extents = positions[self._order], extents[self._order]
        self._starts = np.append(np.arange(0, len(positions), _BLOCK), len(positions))
        first = self._starts[:-1]
        self._low, self._high, self._reach = (
            combine.reduceat(values, first) if len(positions) else values
            for combine, values in (
                (np.minimum, self._positions), (np.maximum, self._positions), (np.maximum, self._extents)
            )
        )  # fmt: skip

    def query(self, queries: Float[Tensor, "Q 3"], k: int) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
        """Finds the k points that are nearest to each query by Mahalanobis distance, nearest first.

        Args:
            queries: Query positions.
            k: Maximum number of neighbours.

        Returns:
            Indices of the points, and their Mahalanobis distances from the query in the dtype of the queries.
        """
        # Of equally distant points, the lower index is first. If there are fewer than k points, all are
        # returned.
        kept = min(k, len(self._positions))
        index = np.full((len(queries), kept), len(self._positions), dtype=np.int64)
        squared = np.full((len(queries), kept), np.inf)
        if index.size:
            x = queries.double().numpy()
            nearest(
                x, self._positions, self._extents, self._order, self._starts, self._low, self._high, self._reach,
                self._bound(queries, x, kept), index, squared,
            )  # fmt: skip
        return torch.from_numpy(index), torch.from_numpy(np.sqrt(squared)).to(queries.dtype)

    def _bound(self, queries: Float[Tensor, "Q 3"], x: np.ndarray, k: int) -> np.ndarray:
        """Returns an upper bound of the squared Mahalanobis distance of each query to the `k`-th nearest point.

        Args:
            queries: Query positions as a tensor.
            x: Query positions as an array, float64 (Q, 3).
            k: Number of neighbours.
        """
        # The search skips points beyond this bound. It is computed from points near the query by Euclidean
        # distance.
        index = self._tree.query(queries, 2 * k)[0]
        own = np.empty_like(self._order)
        own[self._order] = np.arange(len(self._order))
        gaps = (x[:, None] - self._positions[own[index]]) / self._extents[own[index]]
        squared = np.partition((gaps**2).sum(axis=2), k - 1, axis=1)[:, k - 1]
        return np.asarray(squared * (1 + 1e-9))


def _local_order(positions: np.ndarray, extents: np.ndarray) -> np.ndarray:
    """Sorts points so that consecutive points are close in space and of similar size; returns their indices.

    Args:
        positions: Positions of the points, (S, 3).
        extents: Sizes of the points along the axes, (S, 3).
    """
    # The nearest-neighbour search divides the points into blocks in this order. The points of a block are similar,
    # so that it can skip most blocks as a whole.
    # Sorted by the largest extent, rounded down to a power of two, then along the Z-order curve.
    low = positions.min(axis=0, initial=np.inf)
    width = max(float((positions - low).max(initial=0.0)), np.finfo(np.float64).tiny)
    cells = np.floor((positions - low) / width * (2**MAX_AXIS_BITS - 1)).astype(np.int64)
    octave = np.floor(np.log2(extents.max(axis=1, initial=np.finfo(np.float64).tiny)))
    return np.lexsort((morton_encode(cells), -octave))
