"""Order of points in which runs are boxes: a balanced k-d tree whose leaves have sizes that somebody else chose."""

from collections.abc import Sequence

import numpy as np

from splatwire.files.large import large_empty


def kd_order(points: np.ndarray, nested: Sequence[np.ndarray]) -> np.ndarray:
    """Sorts points so that each run between bounds lies apart from the others of the same coarser run.

    Each run is cut at the bound in its middle, across the axis along which its points have the largest variance, until
    it has no bound within.

    Args:
        points: (N, 3), finite.
        nested: Ascending bounds from 0 to N, int64; those of the coarsest runs first, and each has all of those before.

    Returns:
        Indices, int64 (N). Which order points of one of the finest runs have, nobody promises.
    """
    from splatwire.ops import _kd_kernels as kernels

    order = large_empty((len(points),), np.int64)
    order[:] = np.arange(len(points))
    points, outer = np.ascontiguousarray(points, dtype=np.float32), np.array([0, len(points)], dtype=np.int64)
    for inner in nested:
        edges = np.searchsorted(inner, outer)
        for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            kernels.split_runs(points, inner[first : last + 1], order)
        outer = inner
    return order
