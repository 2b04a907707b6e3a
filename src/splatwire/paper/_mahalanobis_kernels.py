"""Compiled search for neighbours by Mahalanobis distance. What it must find is `tests/reference/mahalanobis.py`.

Every query is on its own, so results do not depend on how queries are shared among threads.
"""

from typing import no_type_check

from numba import prange

from splatwire.ops.compiled import njit


@njit(borrows=True)
@no_type_check
def _gap(x, low, high, reach):
    """Least squared distance from a point to anything in a block of points, in the block's largest sizes."""
    total = 0.0
    for axis in range(3):
        away = max(low[axis] - x[axis], x[axis] - high[axis], 0.0) / reach[axis]
        total += away * away
    return total


@njit(borrows=True)
@no_type_check
def _insert(index, distance, candidate, gap):
    """Puts a candidate into the ascending list, equals by index; the farthest falls out."""
    place = distance.shape[0] - 1
    while place > 0 and (distance[place - 1] > gap or (distance[place - 1] == gap and index[place - 1] > candidate)):
        distance[place] = distance[place - 1]
        index[place] = index[place - 1]
        place -= 1
    distance[place] = gap
    index[place] = candidate


@njit(parallel=True)
@no_type_check
def nearest(queries, points, sizes, number, starts, low, high, reach, bound, index, distance):
    """Fills the lists of all queries: `index` and squared `distance`, ascending.

    Args:
        queries: float64 (Q, 3).
        points: float64 (S, 3), block by block.
        sizes: float64 (S, 3), positive.
        number: int64 (S), the points' names; equal distances go to the lower one.
        starts: int64 (B + 1), where blocks begin.
        low: float64 (B, 3), corner of each block.
        high: float64 (B, 3), its other corner.
        reach: float64 (B, 3), its largest sizes.
        bound: float64 (Q), no less than the squared distance of the last neighbour.
        index: int64 (Q, k), filled.
        distance: float64 (Q, k), infinity at first, filled.
    """
    last = index.shape[1] - 1
    for q in prange(queries.shape[0]):
        x, near, far = queries[q], index[q], distance[q]
        limit = bound[q]
        for b in range(starts.shape[0] - 1):
            if _gap(x, low[b], high[b], reach[b]) > limit:
                continue
            for k in range(starts[b], starts[b + 1]):
                gap = 0.0
                for axis in range(3):
                    away = (x[axis] - points[k, axis]) / sizes[k, axis]
                    gap += away * away
                if gap < far[last] or (gap == far[last] and number[k] < near[last]):
                    _insert(near, far, number[k], gap)
            limit = min(limit, far[last])
