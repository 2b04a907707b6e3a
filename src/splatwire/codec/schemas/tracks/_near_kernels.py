"""Numba kernels that find the nearest of a packet's tracks that are known by then."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.tracks.layout import NUM_NEIGHBOURS
from splatwire.ops.compiled import njit

LANES = 2 * NUM_NEIGHBOURS
"""Squares of distances are compared side by side in so many columns."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def know(places, i, known, around, count):
    """Takes a track among the known ones: its number, and its place in columns, which are searched side by side."""
    known[count] = i
    for a in range(3):
        around[a, count] = places[i, a]
    return count + 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def _near(squares, count, lanes, some):
    """Which of `count` squares may be among the `NUM_NEIGHBOURS` least, ascending; returns how many these are.

    As many lanes as there shall be neighbours have one that is not above the largest of their minima.
    """
    if count <= 2 * LANES:
        for m in range(count):
            some[m] = m
        return count
    for j in range(LANES):
        lanes[j] = squares[j]
    whole = count // LANES * LANES
    for begin in range(LANES, whole, LANES):
        for j in range(LANES):
            lanes[j] = squares[begin + j] if squares[begin + j] < lanes[j] else lanes[j]
    for m in range(whole, count):
        lanes[m - whole] = min(lanes[m - whole], squares[m])
    limit, half = 0.0, LANES - NUM_NEIGHBOURS
    for j in range(NUM_NEIGHBOURS):
        limit = max(limit, min(lanes[j], lanes[half + j]))
    taken = 0
    for m in range(count):
        some[taken] = m
        taken += squares[m] <= limit
    return taken


@njit(borrows=True, error_model="numpy")
@no_type_check
def nearest(places, known, around, count, i, squares, lanes, some, who, far):
    """The nearest of the `count` tracks in `known`, nearest first; returns how many. Of equals the earlier one."""
    found = 0
    x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
    for m in range(count):
        dx, dy, dz = around[0, m] - x, around[1, m] - y, around[2, m] - z
        squares[m] = dx * dx + dy * dy + dz * dz  # below 2**53: doubles hold it
    for n in range(_near(squares, count, lanes, some)):
        m = some[n]
        if found == NUM_NEIGHBOURS and squares[m] >= far[found - 1]:
            continue
        d = np.int64(squares[m])
        at = found if found < NUM_NEIGHBOURS else found - 1
        while at > 0 and far[at - 1] > d:
            far[at], who[at] = far[at - 1], who[at - 1]
            at -= 1
        far[at], who[at] = d, known[m]
        found = min(found + 1, NUM_NEIGHBOURS)
    return found
