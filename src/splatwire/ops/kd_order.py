"""Sorting of points into spatially compact ranges: a balanced k-d tree with given leaf sizes."""

from collections.abc import Sequence

import numpy as np

from splatwire.files.mmap_array import large_empty
from splatwire.ops import _kd_kernels as kernels


def kd_order(points: np.ndarray, nested: Sequence[np.ndarray]) -> np.ndarray:
    """Sorts points so that consecutive points form spatially compact groups of given sizes (a k-d tree).

    Args:
        points: (N, 3), finite.
        nested: One array of group boundaries for each level of the tree, beginning with the level of the largest
            groups; int64, ascending from 0 to N. Group i of a level with the array `bounds` consists of the points at
            positions `bounds[i]` to `bounds[i + 1]` (exclusive) of the sorted order. Each array contains all boundaries
            of the array before it.

    Returns:
        Entry i is the index in `points` of the i-th point in sorted order, int64 (N).
    """
    order = large_empty((len(points),), np.int64)
    order[:] = np.arange(len(points))
    points, outer = np.ascontiguousarray(points, dtype=np.float32), np.array([0, len(points)], dtype=np.int64)
    for inner in nested:
        edges = np.searchsorted(inner, outer)
        for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            kernels.split_runs(points, inner[first : last + 1], order)
        outer = inner
    return order
