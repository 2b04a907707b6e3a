"""Compiled tile rasteriser. What it must compute is in `splatwire.render.reference`.

Two facts about speed decide the shape of this file: one row of a tile is one value, `_lanes`; and a tile's pixels stay
in cache while its Gaussians stream by, each asked for ahead of its turn. Tiles have nothing to do with each other, so
results do not depend on how threads share them.
"""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.lanes import choose, load, pick, power_of_two, prefetch, smaller, spread, store
from splatwire.render._cpu_project import SPLAT

TILE = 16
PIXELS = TILE * TILE
MIN_LEVEL = np.float32(np.log2(1.0 / 255.0))
MAX_LEVEL = np.float32(np.log2(0.99))
MIN_TRANSMITTANCE = np.float32(1e-4)
_BLOCK = 4  # tiles
AHEAD = 4
# Sections of a tile's buffer: five of a number per pixel, then the numbers of the columns.
LIVE, RED, GREEN, BLUE, REST, COLUMN = (k * PIXELS for k in range(6))
ZERO, ONE = np.float32(0), np.float32(1)


@njit(borrows=True, inline="never", error_model="numpy")
@no_type_check
def _blend(buf, low, high, x, y, A, B, C, level, red, green, blue):
    """Lays one Gaussian over the rows [low, high) of a tile; `level` is the logarithm of its opacity, base two.

    A pixel's light turns negative when the next Gaussian would take it below the limit: nothing more is drawn there.
    """
    dx = load(buf, COLUMN) - x
    still, slope = dx * dx * A + level, dx * B
    dy = spread(np.float32(low) - y)
    most, zero = spread(min(level, MAX_LEVEL)), spread(ZERO)
    for i in range(low * TILE, high * TILE, TILE):
        power = still + (slope + dy * C) * dy
        dy += ONE
        live = load(buf, i + LIVE)
        weight = choose(power >= MIN_LEVEL, power_of_two(smaller(power, most)) * live, zero)
        after = live - weight
        drawn = after >= MIN_TRANSMITTANCE
        weight = choose(drawn, weight, zero)
        store(buf, i + LIVE, choose(drawn, after, smaller(live, zero - live)))
        store(buf, i + RED, load(buf, i + RED) + weight * red)
        store(buf, i + GREEN, load(buf, i + GREEN) + weight * green)
        store(buf, i + BLUE, load(buf, i + BLUE) + weight * blue)


@njit()
@no_type_check
def new_buffer(columns, rows):
    """A tile's buffer, zero but for the numbers of the columns and the light; pixels beyond the image have none.

    Rows begin where cache lines do.
    """
    size = COLUMN + TILE
    whole = np.zeros(size + TILE, np.float32)
    first = -whole.ctypes.data % 64 // 4
    buf = whole[first : first + size]
    for column in range(TILE):
        buf[COLUMN + column] = column
    for row in range(rows):
        for column in range(columns):
            buf[LIVE + row * TILE + column] = 1.0
    return buf


@njit(borrows=True, fastmath=True)
@no_type_check
def finished(buf):
    """Whether no pixel of a tile lets light through any more."""
    live = np.float32(0)
    for i in range(LIVE, LIVE + PIXELS):
        live = max(live, buf[i])
    return live == 0


@njit(inline="always")
@no_type_check
def ask_for(splats, ids, k):
    """Has a splat fetched that will be drawn soon; those of a tile lie far apart."""
    if k < ids.shape[0]:
        prefetch(splats, np.int64(ids[k]) * SPLAT)


@njit(inline="always")
@no_type_check
def splat_numbers(splats, g, left, top):
    """Of a splat what the pixels of a tile depend on, its place relative to the tile's.

    Without a view of the splat's row, which would be counted: that takes a seventh of all drawing.
    """
    at = np.int64(g) * SPLAT
    x, y = pick(splats, at) - np.float32(left), pick(splats, at + 1) - np.float32(top)
    return (
        x, y, pick(splats, at + 2), pick(splats, at + 3), pick(splats, at + 4), pick(splats, at + 5),
        pick(splats, at + 6), pick(splats, at + 7), pick(splats, at + 8),
    )  # fmt: skip


@njit(error_model="numpy")
@no_type_check
def _draw_tile(splats, ids, spans, begin, end, left, top, background, image, left_over):
    """Draws one tile into `image` and keeps what light passes through it in `left_over`."""
    height, width = left_over.shape
    rows, columns = min(TILE, height - top), min(TILE, width - left)
    buf = new_buffer(columns, rows)
    for k in range(begin, end):
        ask_for(splats, ids, k + AHEAD)
        low, high = np.int64(spans[k, 0]), np.int64(spans[k, 1])  # of unsigned ones a loop is slower
        x, y, A, B, C, level, red, green, blue = splat_numbers(splats, ids[k], left, top)
        _blend(buf, low, high, x, y, A, B, C, level, red, green, blue)
        if (k - begin) % 16 == 15 and finished(buf):
            break
    for row in range(rows):
        for column in range(columns):
            i = row * TILE + column
            t = abs(buf[i + LIVE])
            left_over[top + row, left + column] = t
            for c in range(3):
                image[top + row, left + column, c] = buf[i + RED + c * PIXELS] + t * background[c]


@njit()
@no_type_check
def tile_order(num_tiles, grid_x):
    """Tiles in the order to draw them in: by blocks, since neighbours draw the same Gaussians."""
    grid_y, at = num_tiles // grid_x, 0
    order = np.empty(num_tiles, np.int64)
    for first_y in range(0, grid_y, _BLOCK):
        for first_x in range(0, grid_x, _BLOCK):
            for ty in range(first_y, min(first_y + _BLOCK, grid_y)):
                for tx in range(first_x, min(first_x + _BLOCK, grid_x)):
                    order[at] = ty * grid_x + tx
                    at += 1
    return order


@njit(nogil=True)
@no_type_check
def draw_tiles(splats, starts, ids, spans, grid_x, first_row, background, image, left_over):
    """Draws the tiles whose lists `fill_tiles` made."""
    for t in tile_order(starts.shape[0] - 1, grid_x):
        left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
        _draw_tile(splats, ids, spans, starts[t], starts[t + 1], left, top, background, image, left_over)
