"""Numba kernels for weights and weighted sums of neighbours."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

_TERMS = 10
"""Number of terms of a quadratic function of three coordinates."""
_FIRST_SHAPE, _FIRST_COLOUR, _CHANNELS = 6, 10, 13
_SMALLEST = 1e-30


@njit(borrows=True, error_model="numpy")
@no_type_check
def _solve_first(lower, solution):
    """Solves `A x = (1, 0, ..., 0)` for x by Cholesky decomposition.

    Args:
        lower: The symmetric positive definite matrix A, float64 (10, 10); its lower triangle is overwritten.
        solution: Output: x, float64 (10).
    """
    for a in range(_TERMS):
        for b in range(a + 1):
            total = lower[a, b]
            for k in range(b):
                total -= lower[a, k] * lower[b, k]
            lower[a, b] = np.sqrt(total) if a == b else total / lower[b, b]
    for a in range(_TERMS):
        total = 1.0 if a == 0 else 0.0
        for k in range(a):
            total -= lower[a, k] * solution[k]
        solution[a] = total / lower[a, a]
    for a in range(_TERMS - 1, -1, -1):
        total = solution[a]
        for k in range(a + 1, _TERMS):
            total -= lower[k, a] * solution[k]
        solution[a] = total / lower[a, a]


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def smooth_weights(offsets, ridges, distance_floor, max_weight_sum, proximity, terms, lower, solution, out):
    """Computes weights that interpolate motion by a quadratic function fitted to the neighbours.

    Args:
        offsets: Positions of the k neighbours relative to each of n query points, float64 (n, k, 3).
        ridges: Regularisation of each term, float64 (10).
        distance_floor: Constant that limits the weight of very near neighbours. Each squared distance is divided by the
            mean squared distance of the k neighbours, and the constant is added to the quotient.
        max_weight_sum: Maximum sum of the absolute weights of a query point. If the sum is larger, inverse-distance
            weights are used for this point instead.
        proximity: Temporary memory for inverse-distance weights, float64 (k).
        terms: Temporary memory for the terms of each neighbour, float64 (k, 10).
        lower: Temporary memory for the matrix of the least-squares fit, float64 (10, 10).
        solution: Temporary memory for the solution, float64 (10).
        out: Output: the weights, float32 (n, k).
    """
    count = offsets.shape[1]
    for n in range(len(offsets)):
        mean, total = 0.0, 0.0
        for m in range(count):
            x, y, z = offsets[n, m, 0], offsets[n, m, 1], offsets[n, m, 2]
            proximity[m] = x * x + y * y + z * z
            mean += proximity[m]
        mean = mean / count + _SMALLEST
        unit = 1.0 / np.sqrt(mean)
        for m in range(count):
            proximity[m] = 1.0 / (proximity[m] / mean + distance_floor)
            total += proximity[m]
        lower[:] = 0.0
        for m in range(count):
            proximity[m] /= total
            x, y, z = offsets[n, m, 0] * unit, offsets[n, m, 1] * unit, offsets[n, m, 2] * unit
            row = terms[m]
            row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, z, x * x, y * y
            row[6], row[7], row[8], row[9] = z * z, x * y, x * z, y * z
            for a in range(_TERMS):
                part = proximity[m] * row[a]
                for b in range(a + 1):
                    lower[a, b] += part * row[b]
        for a in range(_TERMS):
            lower[a, a] += ridges[a]
        _solve_first(lower, solution)
        total, size = 0.0, 0.0
        for m in range(count):
            weight = 0.0
            for a in range(_TERMS):
                weight += terms[m, a] * solution[a]
            terms[m, 0] = proximity[m] * weight
            total += terms[m, 0]
        for m in range(count):
            terms[m, 0] /= total
            size += abs(terms[m, 0])
        for m in range(count):
            out[n, m] = proximity[m] if size > max_weight_sum else terms[m, 0]


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def interpolate(index, weights, closeness, contrasts, contrast, values, has_shapes, has_colours, scratch, out):
    """Estimates the motion of n tracks (Gaussians over time) in one frame, each from the motion of k neighbours.

    Motion has 13 channels: changes of position (3), rotation (3), logarithms of scales and opacity (4) and colour (3).
    The estimate is the weighted mean of the neighbours' motion, with two exceptions. Scales and opacity stay within the
    range of the neighbours' values. The change of colour is the mean change plus a slope (-1 to 1) times the track's
    colour difference, because a change of lighting affects bright surfaces more than dark ones.

    Args:
        index: Row in `values` of each neighbour of each track, int32 (n, k).
        weights: Weight of each neighbour for all channels except colour, float32 (n, k).
        closeness: Weight of each neighbour for the mean change of colour, float32 (n, k).
        contrasts: Weights for computing the slope, float32 (n, k, 3). The slope of a track is the weighted sum of its
            neighbours' colour changes, over neighbours and colour channels.
        contrast: Colour difference: colour of each track minus the mean colour of its neighbours, float32 (n, 3).
        values: Motion of the m tracks that serve as neighbours, float32 (m, 13).
        has_shapes: True if a scale or opacity channel in `values` is not 0.
        has_colours: True if a colour channel in `values` is not 0.
        scratch: Temporary memory, float32 (3).
        out: Output: motion of the tracks, float32 (n, 13); zeros before the call.
    """
    last = _CHANNELS if has_colours else _FIRST_COLOUR if has_shapes else _FIRST_SHAPE
    for n in range(len(index)):
        row_out = out[n]
        for m in range(index.shape[1]):
            row, weight = values[index[n, m]], weights[n, m]
            for c in range(min(last, _FIRST_COLOUR)):
                row_out[c] += weight * row[c]
            for c in range(_FIRST_COLOUR, last):
                row_out[c] += closeness[n, m] * row[c]
        if has_shapes:
            for c in range(_FIRST_SHAPE, _FIRST_COLOUR):
                low = high = values[index[n, 0], c]
                for m in range(1, index.shape[1]):
                    value = values[index[n, m], c]
                    low, high = min(low, value), max(high, value)
                row_out[c] = min(max(row_out[c], low), high)
        if has_colours:
            scratch[:] = 0.0
            for m in range(index.shape[1]):
                for a in range(3):
                    scratch[a] += contrasts[n, m, a] * values[index[n, m], _FIRST_COLOUR + a]
            share = min(max(scratch[0] + scratch[1] + scratch[2], np.float32(-1.0)), np.float32(1.0))
            for a in range(3):
                row_out[_FIRST_COLOUR + a] += share * contrast[n, a]
