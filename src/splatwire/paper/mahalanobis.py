"""Exact nearest neighbours by Mahalanobis distance, each point with a covariance of its own (paper, Section 3.4)."""

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.ops.knn import NeighborTree
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode

_BLOCK = 64
"""Points that are looked at, or left out, together."""


class MahalanobisSearch:
    """Points prepared for queries by `sqrt((x_q - x_k)^T diag(size_k)^-2 (x_q - x_k))`.

    All points count, however far: a large one is near to what is far from it. Points of similar size and place share a
    block, and a block is left out only where none of its points can be among the nearest, so the result is exact.

    Args:
        points: Where they are.
        sizes: Their extents along the axes, positive.
    """

    def __init__(self, points: Float[Tensor, "S 3"], sizes: Float[Tensor, "S 3"]) -> None:
        places, extents = points.double().numpy(), sizes.double().numpy()
        self._tree = NeighborTree(points)
        self._order = _local_order(places, extents)
        self._places, self._extents = places[self._order], extents[self._order]
        self._starts = np.append(np.arange(0, len(places), _BLOCK), len(places))
        first = self._starts[:-1]
        self._low, self._high, self._reach = (
            combine.reduceat(values, first) if len(places) else values
            for combine, values in (
                (np.minimum, self._places), (np.maximum, self._places), (np.maximum, self._extents)
            )
        )  # fmt: skip

    def query(self, queries: Float[Tensor, "Q 3"], k: int) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
        """Finds the `kept = min(k, S)` nearest points of each query, nearest first; ties go to the lower index.

        Args:
            queries: Where to look from.
            k: Number of neighbours.

        Returns:
            Indices of the points, and their Mahalanobis distances in the dtype of the queries.
        """
        from splatwire.paper._mahalanobis_kernels import nearest

        kept = min(k, len(self._places))
        index = np.full((len(queries), kept), len(self._places), dtype=np.int64)
        squared = np.full((len(queries), kept), np.inf)
        if index.size:
            x = queries.double().numpy()
            nearest(
                x, self._places, self._extents, self._order, self._starts, self._low, self._high, self._reach,
                self._bound(queries, x, kept), index, squared,
            )  # fmt: skip
        return torch.from_numpy(index), torch.from_numpy(np.sqrt(squared)).to(queries.dtype)

    def _bound(self, queries: Float[Tensor, "Q 3"], x: np.ndarray, kept: int) -> np.ndarray:
        """A squared distance within which there are as many points as are wanted: those nearest by Euclid say one."""
        index = self._tree.query(queries, 2 * kept)[0]
        own = np.empty_like(self._order)
        own[self._order] = np.arange(len(self._order))
        gaps = (x[:, None] - self._places[own[index]]) / self._extents[own[index]]
        squared = np.partition((gaps**2).sum(axis=2), kept - 1, axis=1)[:, kept - 1]
        return np.asarray(squared * (1 + 1e-9))


def _local_order(places: np.ndarray, extents: np.ndarray) -> np.ndarray:
    """Sorts points by octave of their largest extent, then along the Z-order curve."""
    low = places.min(axis=0, initial=np.inf)
    width = max(float((places - low).max(initial=0.0)), np.finfo(np.float64).tiny)
    cells = np.floor((places - low) / width * (2**MAX_AXIS_BITS - 1)).astype(np.int64)
    octave = np.floor(np.log2(extents.max(axis=1, initial=np.finfo(np.float64).tiny)))
    return np.lexsort((morton_encode(cells), -octave))
