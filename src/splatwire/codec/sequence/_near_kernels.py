"""Numba kernels that find, for a track (Gaussian over time), the nearest tracks with known motion in its packet."""

from typing import no_type_check

import numpy as np

from splatwire.codec.sequence.layout import MAX_TRACK_SPAN, NUM_NEIGHBOURS
from splatwire.ops.compiled import njit

LANES = 2 * NUM_NEIGHBOURS
"""Number of squared distances that are compared in parallel (SIMD)."""
_INDEX_BITS, _MAX_INT64 = 13, np.int64((1 << 63) - 1)


@njit(borrows=True, error_model="numpy")
@no_type_check
def add_known(positions, i, known_tracks, known_positions, count):
    """Adds a track (Gaussian over time) to the list of tracks from which the motion of later tracks is predicted.

    Args:
        positions: Positions of the packet's tracks, int64 (M, 3).
        i: Index of the track to add.
        known_tracks: Indices of the tracks with known motion, int64 (M). Output: element `count` becomes `i`.
        known_positions: Positions of the tracks with known motion, float64 (3, M). Output: column `count`.
        count: Number of tracks with known motion, without the new track.

    Returns:
        The new number of tracks with known motion.
    """
    # One row per axis, for a search with SIMD.
    known_tracks[count] = i
    for a in range(3):
        known_positions[a, count] = positions[i, a]
    return count + 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def _find_candidates(squares, count, group_minima, candidates):
    """Preselects the tracks that may be among the nearest neighbours of a point.

    Args:
        squares: Squared distance of each track from the point, float64.
        count: Number of tracks.
        group_minima: Working array for the minimum distances of groups of tracks, float64 (LANES).
        candidates: Output: indices of the preselected tracks, ascending.

    Returns:
        Number of preselected tracks.
    """
    # The distances are divided into `NUM_NEIGHBOURS` groups. No distance above the largest of the groups' minima can be
    # among the smallest.
    if count <= 2 * LANES:
        for m in range(count):
            candidates[m] = m
        return count
    for j in range(LANES):
        group_minima[j] = squares[j]
    whole = count // LANES * LANES
    for begin in range(LANES, whole, LANES):
        for j in range(LANES):
            group_minima[j] = squares[begin + j] if squares[begin + j] < group_minima[j] else group_minima[j]
    for m in range(whole, count):
        group_minima[m - whole] = min(group_minima[m - whole], squares[m])
    limit, half = 0.0, LANES - NUM_NEIGHBOURS
    for j in range(NUM_NEIGHBOURS):
        limit = max(limit, min(group_minima[j], group_minima[half + j]))
    taken = 0
    for m in range(count):
        candidates[taken] = m
        taken += squares[m] <= limit
    return taken


@njit(borrows=True, error_model="numpy")
@no_type_check
def _smallest_candidates(squares, candidates, count):
    """Selects the nearest of the preselected tracks (Gaussians over time).

    Args:
        squares: Squared distances of all tracks, float64.
        candidates: Indices in `squares` of the preselected tracks.
        count: Number of preselected tracks.

    Returns:
        `NUM_NEIGHBOURS` integers, one for each selected track, nearest first. The lowest `_INDEX_BITS` bits of an
        integer are the index of the track in `squares`; the other bits are its squared distance, rounded down. With
        fewer candidates, the last integers are `_MAX_INT64`.
    """
    # The keys stay in registers. No branch depends on a comparison of keys, because processors would often predict it
    # wrongly.
    a = b = c = d = e = f = g = h = _MAX_INT64
    for n in range(count):
        key = (np.int64(squares[candidates[n]]) << _INDEX_BITS) | candidates[n]
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
def nearest(
    positions, known_tracks, known_positions, count, i, squares, group_minima, candidates, neighbours, squared_distances
):
    """Finds the tracks (Gaussians over time) with known motion that are nearest to a given track.

    Args:
        positions: Positions of the packet's tracks, int64 (M, 3).
        known_tracks: Indices of the tracks with known motion, from `add_known`.
        known_positions: Positions of the tracks with known motion, from `add_known`.
        count: Number of tracks with known motion.
        i: Index of the track whose neighbours are searched.
        squares: Working array, float64 (M).
        group_minima: Working array, float64 (LANES).
        candidates: Working array, int64 (M).
        neighbours: Output: indices of the neighbours, nearest first, int64 (NUM_NEIGHBOURS).
        squared_distances: Output: squared distances of the neighbours, int64 (NUM_NEIGHBOURS).

    Returns:
        Number of neighbours found.
    """
    x, y, z = np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2])
    for m in range(count):
        dx, dy, dz = known_positions[0, m] - x, known_positions[1, m] - y, known_positions[2, m] - z
        squares[m] = dx * dx + dy * dy + dz * dz  # below 2**42, exact in float64
    num_found = 0
    for key in _smallest_candidates(squares, candidates, _find_candidates(squares, count, group_minima, candidates)):
        if num_found < count:
            squared_distances[num_found], neighbours[num_found] = (
                key >> _INDEX_BITS,
                known_tracks[key & ((1 << _INDEX_BITS) - 1)],
            )
            num_found += 1
    return num_found


assert NUM_NEIGHBOURS == 8, "`_smallest_candidates` names each of them"
assert MAX_TRACK_SPAN < 1 << _INDEX_BITS, "indices of a packet's tracks fit the low bits"
