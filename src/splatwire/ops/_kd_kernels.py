"""Compiled kernels for sorting points into the leaves of a k-d tree (`splatwire.ops.kd_order`)."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit


@njit(nogil=True)
@no_type_check
def split_runs(points, bounds, order):
    """Sorts points into the leaves of a k-d tree; the numbers of points in the leaves are given.

    Only the points `order[bounds[0]:bounds[-1]]` are sorted.

    Args:
        points: Coordinates of all points, float (N, 3).
        bounds: Boundaries of the leaves, ascending, int64 (leaves + 1). Leaf i gets the points
            `order[bounds[i]:bounds[i + 1]]`.
        order: Rows of `points` in the present order of the points, int64 (N); reordered in place.
    """
    stack = [(np.int64(0), np.int64(len(bounds) - 1))]
    while len(stack):
        first, last = stack.pop()
        if last - first < 2 or bounds[last] - bounds[first] < 2:
            continue
        middle = (first + last) // 2
        begin, end = bounds[first], bounds[last]
        axis = _widest(points, order, begin, end)
        _select(points, axis, order, begin, end - 1, bounds[middle])
        stack.append((first, middle))
        stack.append((middle, last))


@njit()
@no_type_check
def _widest(points, order, begin, end):
    """Returns the axis along which the points `order[begin:end]` have the largest variance."""
    best, axis = -1.0, 0
    for candidate in range(points.shape[1]):
        total, squares, start = 0.0, 0.0, points[order[begin], candidate]
        for index in range(begin, end):
            value = points[order[index], candidate] - start
            total += value
            squares += value * value
        variance = squares - total * total / (end - begin)
        if variance > best:
            best, axis = variance, candidate
    return axis


@njit()
@no_type_check
def _select(points, axis, order, low, high, rank):
    """Partially sorts a range of `order` by one coordinate, until the element at `rank` is in place (quickselect).

    Args:
        points: Coordinates of all points.
        axis: Axis of the coordinate.
        order: Indices of the points in their present order, reordered in place.
        low: First position of the range.
        high: Last position of the range (inclusive).
        rank: Position in `order` whose element must be correct afterwards.
    """
    while low < high:
        pivot = _middle_of_three(points, axis, order, low, high)
        left, right = low - 1, high + 1
        while True:
            left += 1
            while points[order[left], axis] < pivot:
                left += 1
            right -= 1
            while points[order[right], axis] > pivot:
                right -= 1
            if left >= right:
                break
            order[left], order[right] = order[right], order[left]
        if rank <= right:
            high = right
        else:
            low = right + 1


@njit()
@no_type_check
def _middle_of_three(points, axis, order, low, high):
    """Returns a pivot for quickselect: the median of the first, the middle and the last coordinate."""
    a, b, c = points[order[low], axis], points[order[(low + high) // 2], axis], points[order[high], axis]
    return max(min(a, b), min(max(a, b), c))
