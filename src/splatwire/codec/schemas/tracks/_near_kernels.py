"""Numba kernels that find the nearest of a packet's tracks that are known by then."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.tracks.layout import MAX_CANDIDATES, NUM_NEIGHBOURS
from splatwire.ops.compiled import njit

LANES = 2 * NUM_NEIGHBOURS
"""Squares of distances are compared side by side in so many columns."""
_PLACE_BITS, _MOST = 13, np.int64((1 << 63) - 1)


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
def _least(squares, some, count):
    """The least of some squares, ascending, each with its place in its low bits: `NUM_NEIGHBOURS` of them.

    They stay in registers, and no branch depends on which is less: nobody could guess.
    """
    a = b = c = d = e = f = g = h = _MOST
    for n in range(count):
        key = (np.int64(squares[some[n]]) << _PLACE_BITS) | some[n]
        a, key = (key, a) if key < a else (a, key)
        b, key = (key, b) if key < b else (b, key)
        c, key = (key, c) if key < c else (c, key)
        d, key = (key, d) if key < d else (d, key)
        e, key = (key, e) if key < e else (e, key)
        f, key = (key, f) if key < f else (f, key)
        g, key = (key, g) if key < g else (g, key)
        h = key if key < h else h
    return a, b, c, d, e, f, g, h


@njit(borrows=True, error_model="numpy")
@no_type_check
def nearest(places, known, around, count, i, squares, lanes, some, who, far):
    """The nearest of the `count` tracks in `known`, nearest first; returns how many. Of equals the earlier one."""
    x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
    for m in range(count):
        dx, dy, dz = around[0, m] - x, around[1, m] - y, around[2, m] - z
        squares[m] = dx * dx + dy * dy + dz * dz  # below 2**42: doubles hold it
    found = 0
    for key in _least(squares, some, _near(squares, count, lanes, some)):
        if found < count:
            far[found], who[found] = key >> _PLACE_BITS, known[key & ((1 << _PLACE_BITS) - 1)]
            found += 1
    return found


assert NUM_NEIGHBOURS == 8, "`_least` names each of them"
assert MAX_CANDIDATES < 1 << _PLACE_BITS, "places of a packet's tracks fit the low bits"
