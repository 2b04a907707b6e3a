"""Compiled gradient of the tile rasteriser: the same walk as `_cpu_kernels`, nearest first, with sums at each step.

A Gaussian's sums over one tile go to a row of their own, and rows are added up in a fixed order, so the gradient does
not depend on the number of threads either.
"""

from typing import no_type_check

import numpy as np
from numba import njit, prange

from splatwire.render._cpu_kernels import (
    _B,
    _FAST,
    _G,
    _INTERLEAVE,
    _LEFT,
    _LIVE,
    _MAX_ALPHA,
    _MIN_ALPHA,
    _MIN_TRANSMITTANCE,
    _ONE,
    _PX,
    _PY,
    _R,
    _ZERO,
    PIXELS,
    TILE,
    _clear,
    _falloff,
    _finished,
    _row_span,
)

SUMS = 9
"""Sums per Gaussian: h, h dx, h dy, h dx^2, h dx dy, h dy^2 with h the gradient of the exponent; gradient of RGB."""
_REST = _LEFT  # gradient-weighted colour of all that is still to come; takes the place of the forward's section


@njit(cache=True, fastmath=_FAST, inline="never", error_model="numpy")
@no_type_check
def _blend_back(buf, low, high, x, y, A, B, C, opacity, red, green, blue, out):
    """Repeats `_blend` and writes its sums to `out`; what lies behind is the finished picture less what was laid."""
    h0 = hx = hy = hxx = hxy = hyy = cr = cg = cb = _ZERO
    for i in range(low, high):
        dx, dy = buf[i + _PX] - x, buf[i + _PY] - y
        power = min(max((A * dx + B * dy) * dx + C * dy * dy, np.float32(-40)), _ZERO)
        free = opacity * _falloff(power)
        alpha = min(free, _MAX_ALPHA)
        alpha = alpha if alpha >= _MIN_ALPHA else _ZERO
        live = buf[i + _LIVE]
        after = live * (_ONE - alpha)
        drawn = after >= _MIN_TRANSMITTANCE
        weight = alpha * live if drawn else _ZERO
        wanted = buf[i + _R] * red + buf[i + _G] * green + buf[i + _B] * blue
        rest = buf[i + _REST] - weight * wanted
        h = weight * wanted - alpha * rest / (_ONE - alpha)
        h = h if drawn else _ZERO
        h = h if free <= _MAX_ALPHA else _ZERO
        buf[i + _LIVE] = after if drawn else _ZERO
        buf[i + _REST] = rest
        h0 += h
        hx += h * dx
        hy += h * dy
        hxx += h * dx * dx
        hxy += h * dx * dy
        hyy += h * dy * dy
        cr += weight * buf[i + _R]
        cg += weight * buf[i + _G]
        cb += weight * buf[i + _B]
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7], out[8] = h0, hx, hy, hxx, hxy, hyy, cr, cg, cb


@njit(cache=True)
@no_type_check
def _tile_back(splats, ids, entries, begin, end, left, top, image, d_image, rows_of_sums):
    height, width = image.shape[:2]
    rows, columns = min(TILE, height - top), min(TILE, width - left)
    buf = np.empty(7 * PIXELS, np.float32)
    _clear(buf, columns, rows)
    for row in range(rows):
        for column in range(columns):
            i = row * TILE + column
            rest = np.float32(0)
            for c in range(3):
                d = d_image[top + row, left + column, c]
                buf[i + (4 + c) * PIXELS] = d
                rest += d * image[top + row, left + column, c]
            buf[i + 3 * PIXELS] = rest
    for k in range(begin, end):
        s = splats[ids[k]]
        low, high = _row_span(s[1], s[9], top)
        x, y = s[0] - np.float32(left), s[1] - np.float32(top)
        _blend_back(buf, low, high, x, y, s[2], s[3], s[4], s[5], s[6], s[7], s[8], rows_of_sums[entries[k]])
        if (k - begin) % 16 == 15 and _finished(buf):
            break


@njit(cache=True, parallel=True)
@no_type_check
def draw_tiles_back(splats, starts, ids, entries, grid_x, first_row, image, d_image, rows_of_sums):
    """Fills `rows_of_sums` (zeroed by the caller), one row per entry, from the picture and its gradient."""
    num_tiles = starts.shape[0] - 1
    per = (num_tiles + _INTERLEAVE - 1) // _INTERLEAVE
    for p in prange(per * _INTERLEAVE):
        t = (p % per) * _INTERLEAVE + p // per
        if t < num_tiles:
            left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
            _tile_back(splats, ids, entries, starts[t], starts[t + 1], left, top, image, d_image, rows_of_sums)


@njit(cache=True, parallel=True)
@no_type_check
def add_rows(rows_of_sums, entry_start, sums):
    """Adds each Gaussian's rows to its `sums`, in the order of its tiles."""
    for g in prange(sums.shape[0]):
        for e in range(entry_start[g], entry_start[g + 1]):
            for k in range(SUMS):
                sums[g, k] += rows_of_sums[e, k]
