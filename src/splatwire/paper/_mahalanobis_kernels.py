"""Compiled nearest-neighbour search by Mahalanobis distance; the reference is `tests/reference/mahalanobis.py`."""

# Queries are independent, so results do not depend on the number of threads.

from typing import no_type_check

from numba import prange

from splatwire.ops.compiled import njit


@njit(borrows=True)
@no_type_check
def _distance_bound(x, low, high, reach):
    """Returns a lower bound of the squared Mahalanobis distance from a query to the points of a block.

    A block is a group of points that the search skips as a whole if this bound is too large.

    Args:
        x: Query position, float64 (3).
        low: Lower corner of the block's bounding box.
        high: Upper corner of the block's bounding box.
        reach: Largest standard deviation among the block's points along each axis.
    """
    # The nearest-neighbour search skips a block whose bound is too large.
    total = 0.0
    for axis in range(3):
        away = max(low[axis] - x[axis], x[axis] - high[axis], 0.0) / reach[axis]
        total += away * away
    return total


@njit(borrows=True)
@no_type_check
def _insert(index, distance, candidate, gap):
    """Inserts a candidate into a list sorted by distance, then by index, and drops the last entry.

    Args:
        index: Point indices in the list, changed in place.
        distance: Squared distances in the list, changed in place.
        candidate: Index of the candidate.
        gap: Squared distance of the candidate.
    """
    rank = distance.shape[0] - 1
    while rank > 0 and (distance[rank - 1] > gap or (distance[rank - 1] == gap and index[rank - 1] > candidate)):
        distance[rank] = distance[rank - 1]
        index[rank] = index[rank - 1]
        rank -= 1
    distance[rank] = gap
    index[rank] = candidate


@njit(parallel=True)
@no_type_check
def nearest(queries, points, sizes, number, starts, low, high, reach, bound, index, distance):
    """Finds the k nearest points of each query by Mahalanobis distance, nearest first.

    Points are divided into B blocks; blocks that are too far from a query are skipped.

    Args:
        queries: Query positions, float64 (Q, 3).
        points: Point positions, sorted by block, float64 (S, 3).
        sizes: Sizes of the points along the axes, positive, float64 (S, 3).
        number: Index of each point in the order before points were sorted by block, int64 (S).
        starts: Index of the first point of each block, int64 (B + 1); the last entry is S.
        low: Lower corner of each block's bounding box, float64 (B, 3).
        high: Upper corner of each block's bounding box, float64 (B, 3).
        reach: Largest size in each block along each axis, float64 (B, 3).
        bound: Upper bound of the squared distance from each query to its k-th neighbour, float64 (Q).
        index: Output: indices of the neighbours in the order before points were sorted by block, int64 (Q, k).
        distance: Output: squared distances of the neighbours, float64 (Q, k); must be infinite before the call.
    """
    # Points are divided into blocks; blocks that are too far from a query are skipped. Of equally distant points,
    # the one with the lower index is first. `distance` must be initialised with infinity.
    last = index.shape[1] - 1
    for q in prange(queries.shape[0]):
        x, near, far = queries[q], index[q], distance[q]
        limit = bound[q]
        for b in range(starts.shape[0] - 1):
            if _distance_bound(x, low[b], high[b], reach[b]) > limit:
                continue
            for k in range(starts[b], starts[b + 1]):
                gap = 0.0
                for axis in range(3):
                    away = (x[axis] - points[k, axis]) / sizes[k, axis]
                    gap += away * away
                if gap < far[last] or (gap == far[last] and number[k] < near[last]):
                    _insert(near, far, number[k], gap)
            limit = min(limit, far[last])
