"""Compiled tile rasteriser. What it must compute is in `splatwire.render.reference`.

Two facts about speed decide the shape of this file: the compiler turns a loop over pixels into vector instructions only
when the loop is a function of its own, over one flat buffer, without branches; and a tile's pixels then stay in cache
while its Gaussians stream by. Nothing depends on how tiles are shared among threads, so results do not either.
"""

from typing import no_type_check

import numpy as np
from numba import njit, prange

TILE = 16
PIXELS = TILE * TILE
_INTERLEAVE = 16
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc", "nnan", "ninf"}
_MIN_ALPHA = np.float32(1.0 / 255.0)
_MAX_ALPHA = np.float32(0.99)
_MIN_TRANSMITTANCE = np.float32(1e-4)
# Sections of a tile's buffer, in pixels.
_PX, _PY, _LIVE, _LEFT, _R, _G, _B = (np.uint64(k * PIXELS) for k in range(7))
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_BIAS, _EXPONENT = np.float32(127), np.float32(1 << 23)  # a float's exponent field: its offset and its place
_E1, _E2, _E3 = np.float32(0.69314718), np.float32(0.24022651), np.float32(0.05550411)
_E4, _E5, _E6 = np.float32(0.009618129), np.float32(0.0013333558), np.float32(0.00015403530)


@njit(cache=True)
@no_type_check
def depth_order(depths, tiles):
    """Indices of the drawn Gaussians, nearest first, equal depths in their own order (radix sort)."""
    count = 0
    for g in range(depths.shape[0]):
        count += tiles[g, 2] > tiles[g, 0]
    order, spare = np.empty(count, np.int32), np.empty(count, np.int32)
    keys, spare_keys = np.empty(count, np.uint32), np.empty(count, np.uint32)
    k = 0
    for g in range(depths.shape[0]):
        if tiles[g, 2] > tiles[g, 0]:
            order[k] = g
            keys[k] = np.float32(depths[g]).view(np.uint32)  # positive floats sort like their bits
            k += 1
    for digit in range(3):
        shift = np.uint32(11 * digit)
        starts = np.zeros(2049, np.int64)
        for i in range(count):
            starts[((keys[i] >> shift) & np.uint32(2047)) + 1] += 1
        for d in range(2048):
            starts[d + 1] += starts[d]
        for i in range(count):
            d = (keys[i] >> shift) & np.uint32(2047)
            spare[starts[d]], spare_keys[starts[d]] = order[i], keys[i]
            starts[d] += 1
        order, spare, keys, spare_keys = spare, order, spare_keys, keys
    return order


@njit(cache=True)
@no_type_check
def fill_tiles(order, tiles, grid_x, first_row, last_row, entry_start):
    """Lists the Gaussians of each tile in the tile rows [first_row, last_row), nearest first.

    Returns where each tile's list starts, the lists, and for each entry its number when the entries of these
    rows are counted Gaussian by Gaussian (`entry_start`), which is where its gradient goes.
    """
    starts = np.zeros((last_row - first_row) * grid_x + 1, np.int64)
    for g in order:
        for ty in range(max(tiles[g, 1], first_row), min(tiles[g, 3], last_row)):
            for tx in range(tiles[g, 0], tiles[g, 2]):
                starts[(ty - first_row) * grid_x + tx + 1] += 1
    for t in range(starts.shape[0] - 1):
        starts[t + 1] += starts[t]
    heads = starts[:-1].copy()
    ids, entries = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.int64)
    for g in order:
        columns = tiles[g, 2] - tiles[g, 0]
        for ty in range(max(tiles[g, 1], first_row), min(tiles[g, 3], last_row)):
            for tx in range(tiles[g, 0], tiles[g, 2]):
                t = (ty - first_row) * grid_x + tx
                ids[heads[t]] = g
                entries[heads[t]] = entry_start[g] + (ty - max(tiles[g, 1], first_row)) * columns + tx - tiles[g, 0]
                heads[t] += 1
    return starts, ids, entries


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _falloff(power):
    """2 ** power for power in [-40, 0], to 2e-7 relative: a library call would keep the loop from vectorising."""
    whole = np.floor(power + _HALF)
    f = power - whole
    p = _ONE + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * (_E5 + f * _E6)))))
    return p * np.int32((whole + _BIAS) * _EXPONENT).view(np.float32)


@njit(cache=True, fastmath=_FAST, inline="never", error_model="numpy")
@no_type_check
def _blend(buf, low, high, x, y, A, B, C, opacity, red, green, blue):
    """Lays one Gaussian over the pixels [low, high) of a tile. Unsigned indices: signed ones would branch."""
    for i in range(low, high):
        dx, dy = buf[i + _PX] - x, buf[i + _PY] - y
        power = min(max((A * dx + B * dy) * dx + C * dy * dy, np.float32(-40)), _ZERO)
        alpha = min(opacity * _falloff(power), _MAX_ALPHA)
        alpha = alpha if alpha >= _MIN_ALPHA else _ZERO
        live = buf[i + _LIVE]
        after = live * (_ONE - alpha)
        drawn = after >= _MIN_TRANSMITTANCE
        weight = alpha * live if drawn else _ZERO
        buf[i + _LIVE] = after if drawn else _ZERO
        buf[i + _LEFT] = after if drawn else buf[i + _LEFT]
        buf[i + _R] += weight * red
        buf[i + _G] += weight * green
        buf[i + _B] += weight * blue


@njit(cache=True, inline="always")
@no_type_check
def _row_span(splat_y, half_height, top):
    """Pixels of a tile, whole rows, that a splat can reach."""
    low = max(np.int64(np.ceil(splat_y - half_height)) - top, 0)
    high = min(np.int64(np.floor(splat_y + half_height)) - top + 1, TILE)
    return np.uint64(low * TILE), np.uint64(max(high, low) * TILE)


@njit(cache=True)
@no_type_check
def _clear(buf, columns, rows):
    """Sets up a tile's buffer; pixels beyond the image start opaque."""
    for i in range(PIXELS):
        row, column = i // TILE, i % TILE
        inside = row < rows and column < columns
        buf[i], buf[i + PIXELS] = column, row
        buf[i + 2 * PIXELS] = 1.0 if inside else 0.0
        buf[i + 3 * PIXELS] = 1.0
        for k in range(4, 7):
            buf[i + k * PIXELS] = 0.0


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _finished(buf):
    live = np.float32(0)
    for i in range(2 * PIXELS, 3 * PIXELS):
        live = max(live, buf[i])
    return live == 0


@njit(cache=True)
@no_type_check
def _draw_tile(splats, ids, begin, end, left, top, background, image, left_over):
    """Draws one tile into `image` and keeps what light passes through it in `left_over`."""
    height, width = left_over.shape
    rows, columns = min(TILE, height - top), min(TILE, width - left)
    buf = np.empty(7 * PIXELS, np.float32)
    _clear(buf, columns, rows)
    for k in range(begin, end):
        s = splats[ids[k]]
        low, high = _row_span(s[1], s[9], top)
        _blend(
            buf, low, high, s[0] - np.float32(left), s[1] - np.float32(top), s[2], s[3], s[4], s[5], s[6], s[7], s[8]
        )
        if (k - begin) % 16 == 15 and _finished(buf):
            break
    for row in range(rows):
        for column in range(columns):
            i = row * TILE + column
            t = buf[i + 3 * PIXELS]
            left_over[top + row, left + column] = t
            for c in range(3):
                image[top + row, left + column, c] = buf[i + (4 + c) * PIXELS] + t * background[c]


@njit(cache=True, parallel=True)
@no_type_check
def draw_tiles(splats, starts, ids, grid_x, first_row, background, image, left_over):
    """Draws the tiles whose lists `fill_tiles` made."""
    num_tiles = starts.shape[0] - 1
    per = (num_tiles + _INTERLEAVE - 1) // _INTERLEAVE
    for p in prange(per * _INTERLEAVE):
        t = (p % per) * _INTERLEAVE + p // per  # every thread gets tiles from all over the image
        if t < num_tiles:
            left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
            _draw_tile(splats, ids, starts[t], starts[t + 1], left, top, background, image, left_over)
