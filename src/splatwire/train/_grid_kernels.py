"""Compiled lookup in the hash grid, and its gradient. The plain twin is `splatwire.train.grid`."""

from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_CHUNK = 128


@njit(parallel=True)
@no_type_check
def signs(values, out):
    """-1 or +1, +1 at zero."""
    for i in prange(values.shape[0]):
        out[i] = np.float32(1) if values[i] >= 0 else np.float32(-1)


@njit(parallel=True)
@no_type_check
def clip_gradient(values, gradient):
    """Zeroes the gradient where the value is outside [-1, 1]."""
    for i in prange(values.shape[0]):
        if not (-1 <= values[i] <= 1):
            gradient[i] = 0


@njit(inline="never")
@no_type_check
def _gather_chunk(table, rows, weights, index, begin, end, column, out):
    if table.shape[1] == 4:  # spelt out: four sums in registers instead of a loop through memory
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
    """Fills `out`, the levels of the volume first; a chunk of positions stays in cache while the levels go by."""
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
    """Adds to `gradient`; a level's rows belong to it alone, so levels can go side by side."""
    depth, levels3 = gradient.shape[1], rows3.shape[0]
    levels = levels3 + rows2.shape[0]
    half = (levels + 1) // 2
    for job in prange(levels):
        # even levels, then odd ones: those of the volume are the dearest, and threads take runs of jobs
        level = 2 * job if job < half else 2 * (job - half) + 1
        if level < levels3:
            _scatter_level(upstream, rows3[level], weights3[level], index, level * depth, gradient)
        else:
            other = level - levels3
            _scatter_level(upstream, rows2[other], weights2[other], index, level * depth, gradient)
