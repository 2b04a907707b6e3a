"""Compiled search for the lost anchors that a newly received one is near to.

Anchors are ranked along a space-filling curve, so a run of consecutive ranks is a small box. Every run remembers the
largest distance of its anchors to their k-th received neighbour: an arrival further away than that from the box
changes nothing in it. What these kernels must compute is what `NeighborTree.query` finds from scratch.
"""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

RUN = 32
"""Anchors of a run."""
GROUP = 32
"""Runs of a group, which has a box of its own."""


@njit(nogil=True)
@no_type_check
def boxes_of(positions, size):
    """Bounding boxes of runs of `size` points: float64 (runs, 6), lower corner and upper corner."""
    num = positions.shape[0]
    boxes = np.empty(((num + size - 1) // size, 6), np.float64)
    for run in range(boxes.shape[0]):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(run * size, min(num, (run + 1) * size)):
                low, high = min(low, positions[i, axis]), max(high, positions[i, axis])
            boxes[run, axis], boxes[run, 3 + axis] = low, high
    return boxes


@njit(nogil=True)
@no_type_check
def _box_distance(box, x, y, z):
    """Distance of a point to a box, never more than that to a point inside, however sums are rounded."""
    dx = max(max(box[0] - x, x - box[3]), 0.0)
    dy = max(max(box[1] - y, y - box[4]), 0.0)
    dz = max(max(box[2] - z, z - box[5]), 0.0)
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(nogil=True)
@no_type_check
def largest(values, size, result):
    """Largest value of every run of `size`, into `result`."""
    for run in range(result.shape[0]):
        top = -np.inf
        for i in range(run * size, min(values.shape[0], (run + 1) * size)):
            top = max(top, values[i])
        result[run] = top


@njit(nogil=True)
@no_type_check
def _insert(distances, indices, distance, index):
    """Puts a neighbour into the ascending list if it belongs there; ties go to the lower index. True if it did."""
    last = distances.shape[0] - 1
    if not (distance < distances[last] or (distance == distances[last] and index < indices[last])):
        return False
    place = last
    while place > 0 and (
        distances[place - 1] > distance or (distances[place - 1] == distance and indices[place - 1] > index)
    ):
        distances[place], indices[place] = distances[place - 1], indices[place - 1]
        place -= 1
    distances[place], indices[place] = distance, index
    return True


@njit(nogil=True)
@no_type_check
def _offer(first, last, positions, arrival, known, distances, indices, reach, changed):
    """Offers an arrival to the lost anchors of one run; returns how far the run still reaches."""
    k, top = distances.shape[1], -np.inf
    for i in range(first, last):
        if known[i]:
            continue
        dx = positions[i, 0] - positions[arrival, 0]
        dy = positions[i, 1] - positions[arrival, 1]
        dz = positions[i, 2] - positions[arrival, 2]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance <= reach[i] and _insert(distances[i], indices[i], distance, arrival):
            reach[i] = distances[i, k - 1]
            changed[i] = True
        top = max(top, reach[i])
    return top


@njit(nogil=True)
@no_type_check
def insert_arrivals(
    arrivals, positions, known, distances, indices, reach, run_boxes, run_reach, group_boxes, group_reach, changed
):
    """Offers arrivals to all lost anchors that they may be near to.

    Args:
        arrivals: int64, ranks that have arrived; `known` is True for them already.
        positions: float64 (N, 3).
        known: bool (N), what has arrived.
        distances: float64 (N, k), of the nearest received anchors, ascending, infinite where there is none.
        indices: int64 (N, k), those anchors.
        reach: float64 (N), the last of `distances`; -inf for received anchors.
        run_boxes: Boxes of runs of `RUN` anchors.
        run_reach: Largest reach of each run.
        group_boxes: Boxes of groups of `GROUP` runs.
        group_reach: Largest reach of each group.
        changed: bool (N), set where the neighbours changed.
    """
    num = positions.shape[0]
    for a in arrivals:
        x, y, z = positions[a, 0], positions[a, 1], positions[a, 2]
        for group in range(group_boxes.shape[0]):
            if group_reach[group] < 0 or _box_distance(group_boxes[group], x, y, z) > group_reach[group]:
                continue
            top = -np.inf
            for run in range(group * GROUP, min(run_boxes.shape[0], (group + 1) * GROUP)):
                if run_reach[run] >= 0 and _box_distance(run_boxes[run], x, y, z) <= run_reach[run]:
                    first, last = run * RUN, min(num, (run + 1) * RUN)
                    run_reach[run] = _offer(first, last, positions, a, known, distances, indices, reach, changed)
                top = max(top, run_reach[run])
            group_reach[group] = top


@njit(nogil=True)
@no_type_check
def reverse_lists(index):
    """Turns neighbour lists around: who has anchor a in its list.

    Args:
        index: int32 (N, k), neighbours of each anchor.

    Returns:
        Bounds int64 (N + 1) and owners int32 (N k): `owners[bounds[a]:bounds[a + 1]]` have a in their list.
    """
    num, k = index.shape
    bounds = np.zeros(num + 1, np.int64)
    for i in range(num):
        for j in range(k):
            bounds[index[i, j] + 1] += 1
    for a in range(num):
        bounds[a + 1] += bounds[a]
    place, owners = bounds[:-1].copy(), np.empty(num * k, np.int32)
    for i in range(num):
        for j in range(k):
            a = index[i, j]
            owners[place[a]] = i
            place[a] += 1
    return bounds, owners


@njit(nogil=True)
@no_type_check
def count_arrivals(arrivals, bounds, owners, weights, lost, changed):
    """Takes the weights of arrivals out of the lost neighbours of whoever counts them, and marks those."""
    for a in arrivals:
        for j in range(bounds[a], bounds[a + 1]):
            lost[owners[j]] -= weights[a]
            changed[owners[j]] = True
