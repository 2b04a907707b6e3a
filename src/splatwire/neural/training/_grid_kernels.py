"""Compiled interpolation in the binary hash grid, and its gradient."""

from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_CHUNK = 128


@njit(parallel=True)
@no_type_check
def signs(values, out):
    """Writes the signs of `values` to `out`: -1 or +1, +1 for zero."""
    for i in prange(values.shape[0]):
        out[i] = np.float32(1) if values[i] >= 0 else np.float32(-1)


@njit(parallel=True)
@no_type_check
def clip_gradient(values, gradient):
    """Converts the gradient with respect to the signs of values to the gradient with respect to the values, in place.

    The gradient is kept for values within [-1, 1] and set to zero for others (straight-through estimator).

    Args:
        values: The trained values.
        gradient: Gradient with respect to the signs, changed in place.
    """
    for i in prange(values.shape[0]):
        if not (-1 <= values[i] <= 1):
            gradient[i] = 0


@njit(inline="never")
@no_type_check
def _gather_chunk(table, rows, weights, index, begin, end, column, out):
    if table.shape[1] == 4:  # unrolled loop: the four sums stay in registers
        for n in range(begin, end):
            anchor = index[n]
            a = b = c = d = np.float32(0)
            for k in range(rows.shape[1]):
                row, weight = rows[anchor, k], weights[anchor, k]
                a += weight * table[row, 0]
                b += weight * table[row, 1]
                c += weight * table[row, 2]
                d += weight * table[row, 3]
            out[n, column], out[n, column + 1], out[n, column + 2], out[n, column + 3] = a, b, c, d
    else:
        for n in range(begin, end):
            anchor = index[n]
            for f in range(table.shape[1]):
                total = np.float32(0)
                for k in range(rows.shape[1]):
                    total += weights[anchor, k] * table[rows[anchor, k], f]
                out[n, column + f] = total


@njit(parallel=True)
@no_type_check
def interpolate(table, rows3, weights3, rows2, weights2, index, out):
    """Interpolates the tables of the hash grid at some positions.

    The grid has 3D levels, and 2D levels for the projections of a position onto the planes xy, xz and yz.

    Args:
        table: Concatenated tables of all levels, (rows, D).
        rows3: Table rows of the grid cell's corners on the 3D levels, for all positions, (L3, N, 8).
        weights3: Interpolation weights of the corners on the 3D levels, (L3, N, 8).
        rows2: Table rows of the grid cell's corners on the 2D levels, for all positions, (L2, N, 4).
        weights2: Interpolation weights of the corners on the 2D levels, (L2, N, 4).
        index: Indices of the positions at which to interpolate, (M).
        out: Output: the features at the positions `index`, level after level, (M, (L3 + L2) D).
    """
    # Positions are processed in chunks whose data stays in the CPU cache.
    depth, levels3 = table.shape[1], rows3.shape[0]
    for c in prange((index.shape[0] + _CHUNK - 1) // _CHUNK):
        begin, end = c * _CHUNK, min((c + 1) * _CHUNK, index.shape[0])
        for level in range(levels3):
            _gather_chunk(table, rows3[level], weights3[level], index, begin, end, level * depth, out)
        for level in range(rows2.shape[0]):
            _gather_chunk(table, rows2[level], weights2[level], index, begin, end, (levels3 + level) * depth, out)


@njit(inline="never")
@no_type_check
def _scatter_level(upstream, rows, weights, index, column, gradient):
    if gradient.shape[1] == 4:
        for n in range(index.shape[0]):
            anchor = index[n]
            a, b = upstream[n, column], upstream[n, column + 1]
            c, d = upstream[n, column + 2], upstream[n, column + 3]
            for k in range(rows.shape[1]):
                row, weight = rows[anchor, k], weights[anchor, k]
                gradient[row, 0] += weight * a
                gradient[row, 1] += weight * b
                gradient[row, 2] += weight * c
                gradient[row, 3] += weight * d
    else:
        for n in range(index.shape[0]):
            anchor = index[n]
            for k in range(rows.shape[1]):
                for f in range(gradient.shape[1]):
                    gradient[rows[anchor, k], f] += weights[anchor, k] * upstream[n, column + f]


@njit(parallel=True)
@no_type_check
def scatter(upstream, rows3, weights3, rows2, weights2, index, gradient):
    """Computes the gradient with respect to the tables of the hash grid, and adds it to `gradient`.

    The grid has 3D levels, and 2D levels for the projections of a position onto the planes xy, xz and yz.

    Args:
        upstream: Gradient with respect to the result of `interpolate`, (M, (L3 + L2) D).
        rows3: Table rows of the grid cell's corners on the 3D levels, for all positions, (L3, N, 8).
        weights3: Interpolation weights of the corners on the 3D levels, (L3, N, 8).
        rows2: Table rows of the grid cell's corners on the 2D levels, for all positions, (L2, N, 4).
        weights2: Interpolation weights of the corners on the 2D levels, (L2, N, 4).
        index: Indices of the positions that were interpolated, (M).
        gradient: Gradient with respect to the tables, (rows, D); changed in place.
    """
    depth, levels3 = gradient.shape[1], rows3.shape[0]
    levels = levels3 + rows2.shape[0]
    half = (levels + 1) // 2
    for job in prange(levels):
        # even levels, then odd ones: spreads the volume's levels, the most expensive ones, over the threads, each of
        # which takes consecutive jobs
        level = 2 * job if job < half else 2 * (job - half) + 1
        if level < levels3:
            _scatter_level(upstream, rows3[level], weights3[level], index, level * depth, gradient)
        else:
            other = level - levels3
            _scatter_level(upstream, rows2[other], weights2[other], index, level * depth, gradient)
