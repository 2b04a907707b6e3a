"""Numba kernels that find the nearest neighbours of a Gaussian and predict its attributes from theirs.

Neighbours are Gaussians of the same packet that are coded earlier. Predictions are bit-identical on every machine.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import (
    AXIS,
    CLASS,
    LUMA,
    MAX_SQUARED_DISTANCE,
    NUM_DEVIATION_CONTEXTS,
    NUM_NEIGHBOURS,
    OPACITY,
    WINDOW,
)
from splatwire.ops.compiled import njit

NARROW_BITS = 11
"""Maximum number of bits of a cell for which a squared distance and an index of the window fit in an int32."""
NUM_GROUPS = 8
"""Number of groups into which the search window is divided; preceding Gaussian k is in group `k % NUM_GROUPS`."""
DISTANCE_LIMIT = np.float32(3 << 23)
"""Number above all squared distances between cells of at most `NARROW_BITS` bits; exact in a float32."""
PADDING_CELL = np.float32(-(1 << 13))
"""Coordinate of the padding before the first Gaussian, whose squared distances exceed `DISTANCE_LIMIT`."""
MAX_KEY = np.int32(0x7FFFFFFF)
_AGE_BITS = np.int32(6)
"""Number of low bits of a key that contain the distance in packet order."""
_AGE_MASK = np.int64(WINDOW - 1)
LUMA_VALUE, CLASS_VALUE = np.int64(4), np.int64(7)
"""Columns of luma and class in `Neighbours.values`. Columns 0 to 3 are those from `OPACITY` to `FLATNESS` of a row."""
NUM_VALUES, NUM_PREDICTED = 8, 7
"""Number of columns of `Neighbours.values`, and of those that are predicted: the class only selects a context."""
BIT_LENGTHS = np.array([value.bit_length() for value in range(256)], dtype=np.int64)
"""Number of bits of each integer below 256."""


class Neighbours(NamedTuple):
    """Working arrays for finding the neighbours of a Gaussian in its packet, and for predicting its attributes.

    Only Gaussians that precede it in packet order can be neighbours.

    Attributes:
        cells: int64 (3, n), grid cells of the packet's n Gaussians.
        narrow: float32 (3, `WINDOW` + n), the same cells for a faster search; the first columns are padding.
        keys: int32 (`WINDOW`), sort key of each preceding Gaussian: squared distance, then distance in packet order.
        close: int32 (`WINDOW` + 1), keys of the candidates for neighbours.
        group_minima: int32 (`NUM_GROUPS`), smallest key of each group of `WINDOW / NUM_GROUPS` preceding Gaussians.
        indices: int64 (`NUM_NEIGHBOURS`), indices of the neighbours, nearest first.
        weights: float64 (`NUM_NEIGHBOURS`), weights of the neighbours by inverse squared distance.
        values: float64 (n, `NUM_VALUES`), decoded attributes: those that are predicted, and the class.
        axes: float64 (n, 4), primary axis of each Gaussian, and its kind (0 for the largest scale, 2 for the smallest).
        means: int64 (`NUM_PREDICTED`), weighted mean of each predicted attribute over the neighbours.
        deviations: int64 (`NUM_PREDICTED`), weighted mean deviation of the neighbours from this mean.
    """

    cells: np.ndarray
    narrow: np.ndarray
    keys: np.ndarray
    close: np.ndarray
    group_minima: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    axes: np.ndarray
    means: np.ndarray
    deviations: np.ndarray


@njit(error_model="numpy")
@no_type_check
def new_neighbours(n):
    """Allocates the working arrays for predicting the n Gaussians of a packet from their neighbours."""
    narrow = np.empty((3, WINDOW + n), np.float32)
    narrow[:, :WINDOW] = PADDING_CELL
    return Neighbours(
        np.empty((3, n), np.int64),
        narrow,
        np.empty(WINDOW, np.int32),
        np.empty(WINDOW + 1, np.int32),
        np.empty(NUM_GROUPS, np.int32),
        np.empty(NUM_NEIGHBOURS, np.int64),
        np.empty(NUM_NEIGHBOURS, np.float64),
        np.empty((n, NUM_VALUES), np.float64),
        np.empty((n, 4), np.float64),
        np.empty(NUM_PREDICTED, np.int64),
        np.empty(NUM_PREDICTED, np.int64),
    )


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def find_neighbours(neighbours, i, bits):
    """Finds the nearest neighbours of a Gaussian among the preceding `WINDOW` Gaussians of its packet.

    Args:
        neighbours: Working arrays of the packet; indices and weights of the neighbours are written.
        i: Index of the Gaussian in the packet.
        bits: Number of bits of a coordinate of a grid cell.

    Returns:
        Number of neighbours found, at most `NUM_NEIGHBOURS`.
    """
    return _find_narrow(neighbours, i) if bits <= NARROW_BITS else _find_wide(neighbours, i)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _find_narrow(neighbours, i):
    """Finds the nearest neighbours of a Gaussian among the preceding `WINDOW` Gaussians of its packet.

    Fast version of the search, for grid cells whose coordinates have at most `NARROW_BITS` bits.

    Args:
        neighbours: Working arrays of the packet; indices and weights of the neighbours are written.
        i: Index of the Gaussian in the packet.

    Returns:
        Number of neighbours found, at most `NUM_NEIGHBOURS`.
    """
    # The nearest neighbours are the Gaussians with the smallest keys (see `Neighbours`). The distances are exact.
    #
    # The window is divided into eight groups. At least six keys do not exceed the sixth smallest of the groups' minima,
    # so larger keys need not be sorted. The loops have few branches and compile to vector instructions. Coordinates are
    # float32, because numba computes with int32 in 64 bits.
    keys, close, group_minima, indices, weights = (
        neighbours.keys,
        neighbours.close,
        neighbours.group_minima,
        neighbours.indices,
        neighbours.weights,
    )
    narrow = neighbours.narrow
    xs, ys, zs = narrow[0, i : i + WINDOW], narrow[1, i : i + WINDOW], narrow[2, i : i + WINDOW]
    x, y, z = narrow[0, i + WINDOW], narrow[1, i + WINDOW], narrow[2, i + WINDOW]
    for k in range(WINDOW):
        a, b, c = x - xs[k], y - ys[k], z - zs[k]
        keys[k] = (np.int32(min(a * a + b * b + c * c, DISTANCE_LIMIT)) << _AGE_BITS) | np.int32(WINDOW - 1 - k)
    for group in range(NUM_GROUPS):
        group_minima[group] = keys[group]
    for row in range(1, WINDOW // NUM_GROUPS):
        for group in range(NUM_GROUPS):
            group_minima[group] = min(group_minima[group], keys[NUM_GROUPS * row + group])
    largest = second = bound = np.int32(-1)  # the bound is the third largest of eight, the sixth smallest
    for group in range(NUM_GROUPS):
        rest = group_minima[group]
        largest, rest = max(largest, rest), min(largest, rest)
        second, rest = max(second, rest), min(second, rest)
        bound = max(bound, rest)
    num_close = 0
    for k in range(WINDOW):
        close[num_close] = keys[k]
        num_close += 1 if keys[k] <= bound else 0
    k0 = k1 = k2 = k3 = k4 = k5 = MAX_KEY
    for k in range(min(num_close, WINDOW)):
        rest = close[k]
        rest, k0 = max(k0, rest), min(k0, rest)
        rest, k1 = max(k1, rest), min(k1, rest)
        rest, k2 = max(k2, rest), min(k2, rest)
        rest, k3 = max(k3, rest), min(k3, rest)
        rest, k4 = max(k4, rest), min(k4, rest)
        k5 = min(k5, rest)
    indices[0], indices[1], indices[2], indices[3], indices[4], indices[5] = k0, k1, k2, k3, k4, k5
    num_neighbours = min(i, NUM_NEIGHBOURS)
    nearest = np.float64(((np.int64(k0) >> _AGE_BITS) + 1) << 12)
    for m in range(num_neighbours):
        key = indices[m]
        weights[m] = np.floor(nearest / np.float64((key >> _AGE_BITS) + 1))
        indices[m] = i - 1 - (key & _AGE_MASK)
    return num_neighbours


@njit(borrows=True, error_model="numpy")
@no_type_check
def _find_wide(neighbours, i):
    """Finds the nearest neighbours of a Gaussian among the preceding `WINDOW` Gaussians of its packet.

    Slow version of the search, for grid cells with coordinates of any size.

    Args:
        neighbours: Working arrays of the packet; indices and weights of the neighbours are written.
        i: Index of the Gaussian in the packet.

    Returns:
        Number of neighbours found, at most `NUM_NEIGHBOURS`.
    """
    cells, indices, weights = neighbours.cells, neighbours.indices, neighbours.weights
    squared_distances = weights  # the same array: each weight replaces the squared distance from which it is computed
    num_neighbours = 0
    for j in range(i - 1, max(i - WINDOW, 0) - 1, -1):
        x, y, z = cells[0, i] - cells[0, j], cells[1, i] - cells[1, j], cells[2, i] - cells[2, j]
        d = np.float64(min(x * x + y * y + z * z, MAX_SQUARED_DISTANCE))
        if num_neighbours == NUM_NEIGHBOURS and d >= squared_distances[num_neighbours - 1]:
            continue
        at = num_neighbours if num_neighbours < NUM_NEIGHBOURS else num_neighbours - 1
        while at > 0 and squared_distances[at - 1] > d:
            squared_distances[at], indices[at] = squared_distances[at - 1], indices[at - 1]
            at -= 1
        squared_distances[at], indices[at] = d, j
        num_neighbours = min(num_neighbours + 1, NUM_NEIGHBOURS)
    nearest = (squared_distances[0] + 1) * 4096.0
    for m in range(num_neighbours):
        weights[m] = np.floor(nearest / (squared_distances[m] + 1))
    return num_neighbours


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def predict(neighbours, num_neighbours, block_means):
    """Predicts the attributes of a Gaussian as weighted means over the neighbours that `find_neighbours` found.

    The means are written to `neighbours.means`. The mean deviations of the neighbours from the means are written to
    `neighbours.deviations`.

    Args:
        neighbours: Working arrays of the packet (`Neighbours`), with the neighbours of the Gaussian.
        num_neighbours: Number of neighbours.
        block_means: Means of the block (see `SideInfo.block_means`), int64 (7), used if there are no neighbours.

    Returns:
        Context of the entropy coder for the Gaussian's precision class. The context is 0 without neighbours. With
        neighbours, it is 1 plus twice their mean precision class, rounded.
    """
    indices, weights, values, means, deviations = (
        neighbours.indices,
        neighbours.weights,
        neighbours.values,
        neighbours.means,
        neighbours.deviations,
    )
    if num_neighbours == 0:
        for c in range(NUM_PREDICTED):
            means[c], deviations[c] = block_means[c], 0
        return np.int64(0)
    total = a = b = c = d = e = f = g = class_sum = 0.0
    for m in range(num_neighbours):
        j, w = indices[m], weights[m]
        total += w
        a += w * values[j, 0]
        b += w * values[j, 1]
        c += w * values[j, 2]
        d += w * values[j, 3]
        e += w * values[j, 4]
        f += w * values[j, 5]
        g += w * values[j, 6]
        class_sum += w * values[j, 7]
    a, b, c, d = np.floor(a / total), np.floor(b / total), np.floor(c / total), np.floor(d / total)
    e, f, g = np.floor(e / total), np.floor(f / total), np.floor(g / total)
    aa = bb = cc = dd = ee = ff = gg = 0.0
    for m in range(num_neighbours):
        j, w = indices[m], weights[m]
        aa += w * abs(values[j, 0] - a)
        bb += w * abs(values[j, 1] - b)
        cc += w * abs(values[j, 2] - c)
        dd += w * abs(values[j, 3] - d)
        ee += w * abs(values[j, 4] - e)
        ff += w * abs(values[j, 5] - f)
        gg += w * abs(values[j, 6] - g)
    means[0], means[1], means[2], means[3], means[4], means[5], means[6] = a, b, c, d, e, f, g
    # Quotients of numbers that are not negative: conversion to an integer rounds down.
    deviations[0], deviations[1], deviations[2] = aa / total, bb / total, cc / total
    deviations[3], deviations[4], deviations[5], deviations[6] = dd / total, ee / total, ff / total, gg / total
    return 1 + np.int64((4.0 * class_sum + total) / (2.0 * total))


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def store_values(neighbours, row, i):
    """Stores a Gaussian's decoded attributes for the prediction of later Gaussians of the packet.

    Args:
        neighbours: Working arrays of the packet (`Neighbours`), changed in place.
        row: Decoded integers of the Gaussian, int64 (columns).
        i: Index of the Gaussian in the packet.
    """
    values = neighbours.values
    for c in range(4):
        values[i, c] = row[OPACITY + c]
    for c in range(3):
        values[i, LUMA_VALUE + c] = row[LUMA + c]
    values[i, CLASS_VALUE] = row[CLASS]
    for c in range(4):
        neighbours.axes[i, c] = row[AXIS + c]  # the index of the primary axis follows its coordinates


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def deviation_context_of(num_neighbours, deviation, shift):
    """Returns the index of the entropy coder's context for the residual of one attribute of a Gaussian.

    Args:
        num_neighbours: Number of the Gaussian's neighbours.
        deviation: Mean distance of the neighbours' values from the prediction.
        shift: log2 of the quantisation step, in the unit of `deviation`.

    Returns:
        0 without neighbours, 1 for one or two neighbours. Otherwise 2 or more, growing with the deviation in
        quantisation steps, and less than `NUM_DEVIATION_CONTEXTS`.
    """
    if num_neighbours < 3:
        return 0 if num_neighbours == 0 else 1
    ratio = (deviation << 3) >> shift
    return 2 + (min(BIT_LENGTHS[ratio], NUM_DEVIATION_CONTEXTS - 3) if ratio < 256 else NUM_DEVIATION_CONTEXTS - 3)
