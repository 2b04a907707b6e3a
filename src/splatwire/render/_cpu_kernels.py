"""Compiled tile rasteriser; the simple reference is `splatwire.neural.render.reference`."""

# Its speed has two reasons. A pixel row of a tile is one SIMD vector (`ops.lanes`). The pixels of a tile stay in the
# cache while its Gaussians are read, and each Gaussian is prefetched before use. Tiles are independent, so results do
# not depend on the number of threads.

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.lanes import choose, load, pick, power_of_two, prefetch, smaller, spread, store
from splatwire.render._cpu_project import PROJECTED_STRIDE

TILE = 16
PIXELS = TILE * TILE
MIN_LOG_ALPHA = np.float32(np.log2(1.0 / 255.0))
MAX_LOG_ALPHA = np.float32(np.log2(0.99))
MIN_TRANSMITTANCE = np.float32(1e-4)
_BLOCK = 4  # tiles
PREFETCH_DISTANCE = 4
# Sections of a tile's buffer: five of a number per pixel, then the numbers of the columns. Only `_cpu_gradients` uses
# `REST`: the gradient times the colour behind the Gaussians so far, summed over the colour components.
TRANSMITTANCE, RED, GREEN, BLUE, REST, COLUMN = (k * PIXELS for k in range(6))
ZERO, ONE = np.float32(0), np.float32(1)


@njit(borrows=True, inline="never", error_model="numpy")
@no_type_check
def _blend(buf, low, high, x, y, A, B, C, log_opacity, red, green, blue):
    """Blends one Gaussian over some pixel rows of a tile.

    Args:
        buf: Pixel buffer of the tile; changed in place.
        low: First pixel row.
        high: End of the pixel rows (exclusive).
        x: Column of the Gaussian's centre, relative to the tile, pixels.
        y: Row of the Gaussian's centre, relative to the tile, pixels.
        A: Coefficient of dx ** 2 in log2 of alpha; dx and dy are distances from the centre, pixels.
        B: Coefficient of dx * dy in log2 of alpha.
        C: Coefficient of dy ** 2 in log2 of alpha.
        log_opacity: log2 of the opacity.
        red: Red component of the Gaussian's colour.
        green: Green component of the colour.
        blue: Blue component of the colour.
    """
    # If the Gaussian would reduce the transmittance of a pixel below the minimum, the pixel is finished. The
    # transmittance of a finished pixel is stored with a negative sign, and later Gaussians do not change the pixel.
    dx = load(buf, COLUMN) - x
    constant, slope = dx * dx * A + log_opacity, dx * B
    dy = spread(np.float32(low) - y)
    max_exponent, zero = spread(min(log_opacity, MAX_LOG_ALPHA)), spread(ZERO)
    for i in range(low * TILE, high * TILE, TILE):
        power = constant + (slope + dy * C) * dy
        dy += ONE
        transmittance = load(buf, i + TRANSMITTANCE)
        weight = choose(power >= MIN_LOG_ALPHA, power_of_two(smaller(power, max_exponent)) * transmittance, zero)
        after = transmittance - weight
        drawn = after >= MIN_TRANSMITTANCE
        weight = choose(drawn, weight, zero)
        store(buf, i + TRANSMITTANCE, choose(drawn, after, smaller(transmittance, zero - transmittance)))
        store(buf, i + RED, load(buf, i + RED) + weight * red)
        store(buf, i + GREEN, load(buf, i + GREEN) + weight * green)
        store(buf, i + BLUE, load(buf, i + BLUE) + weight * blue)


@njit()
@no_type_check
def new_buffer(columns, rows):
    """Returns a new pixel buffer for a tile, with full transmittance inside the image.

    Args:
        columns: Number of pixel columns of the tile inside the image.
        rows: Number of pixel rows of the tile inside the image.
    """
    # It is initialised with column numbers and transmittance 1 (0 outside the image). Pixel rows are aligned to
    # cache lines.
    size = COLUMN + TILE
    whole = np.zeros(size + TILE, np.float32)
    first = -whole.ctypes.data % 64 // 4
    buf = whole[first : first + size]
    for column in range(TILE):
        buf[COLUMN + column] = column
    for row in range(rows):
        for column in range(columns):
            buf[TRANSMITTANCE + row * TILE + column] = 1.0
    return buf


@njit(borrows=True, fastmath=True)
@no_type_check
def finished(buf):
    """True if no pixel of a tile has transmittance left, so that further Gaussians are invisible."""
    largest = np.float32(0)
    for i in range(TRANSMITTANCE, TRANSMITTANCE + PIXELS):
        largest = max(largest, buf[i])
    return largest == 0


@njit(inline="always")
@no_type_check
def prefetch_projected(projected, ids, k):
    """Prefetches the projected Gaussian `ids[k]`, which will be drawn soon, into the processor's cache."""
    # The Gaussians of a tile are scattered in memory.
    if k < ids.shape[0]:
        prefetch(projected, np.int64(ids[k]) * PROJECTED_STRIDE)


@njit(inline="always")
@no_type_check
def read_projected(projected, g, left, top):
    """Returns the values of a projected Gaussian that blending needs.

    Args:
        projected: Projected Gaussians.
        g: Index of the Gaussian.
        left: Left edge of the tile, pixels.
        top: Top edge of the tile, pixels.

    Returns:
        The arguments `x`, `y`, `A`, `B`, `C`, `log_opacity`, `red`, `green` and `blue` of `_blend`, in this order.
    """
    # Single values are read, because an array view of the row would be slower (reference counting).
    at = np.int64(g) * PROJECTED_STRIDE
    x, y = pick(projected, at) - np.float32(left), pick(projected, at + 1) - np.float32(top)
    return (
        x, y, pick(projected, at + 2), pick(projected, at + 3), pick(projected, at + 4), pick(projected, at + 5),
        pick(projected, at + 6), pick(projected, at + 7), pick(projected, at + 8),
    )  # fmt: skip


@njit(error_model="numpy")
@no_type_check
def _draw_tile(projected, ids, spans, begin, end, left, top, background, image, transmittance):
    """Draws one tile of an image.

    Args:
        projected: Projected Gaussians.
        ids: Indices of Gaussians; those from `begin` to `end` (exclusive) are in this tile, nearest first.
        spans: For each entry of `ids`, the pixel rows of the tile that its Gaussian covers: first row and end
            (exclusive).
        begin: First entry of `ids` for this tile.
        end: End of the entries (exclusive).
        left: Left edge of the tile, pixels.
        top: Top edge of the tile, pixels.
        background: RGB of the background.
        image: Output: RGB of the pixels.
        transmittance: Output: remaining transmittance of the pixels.
    """
    height, width = transmittance.shape
    rows, columns = min(TILE, height - top), min(TILE, width - left)
    buf = new_buffer(columns, rows)
    for k in range(begin, end):
        prefetch_projected(projected, ids, k + PREFETCH_DISTANCE)
        low, high = np.int64(spans[k, 0]), np.int64(spans[k, 1])  # loops over unsigned integers are slower
        x, y, A, B, C, log_opacity, red, green, blue = read_projected(projected, ids[k], left, top)
        _blend(buf, low, high, x, y, A, B, C, log_opacity, red, green, blue)
        if (k - begin) % 16 == 15 and finished(buf):
            break
    for row in range(rows):
        for column in range(columns):
            i = row * TILE + column
            t = abs(buf[i + TRANSMITTANCE])
            transmittance[top + row, left + column] = t
            for c in range(3):
                image[top + row, left + column, c] = buf[i + RED + c * PIXELS] + t * background[c]


@njit()
@no_type_check
def tile_order(num_tiles, grid_x):
    """Returns the order in which image tiles are drawn: square blocks of tiles, row by row within a block.

    Args:
        num_tiles: Number of tiles.
        grid_x: Number of tile columns of the image.
    """
    # Neighbouring tiles share Gaussians in the cache.
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
def draw_tiles(projected, starts, ids, spans, grid_x, first_row, background, image, transmittance):
    """Draws rows of tiles of an image.

    Args:
        projected: Projected Gaussians.
        starts: Start of each tile's list in `ids`, and the end of the last list.
        ids: Lists of all tiles, one after another: indices of Gaussians, nearest first.
        spans: Pixel rows that each entry of `ids` covers in its tile: first row and end (exclusive).
        grid_x: Number of tile columns.
        first_row: First row of tiles.
        background: RGB of the background.
        image: Output: RGB of the pixels.
        transmittance: Output: remaining transmittance of the pixels.
    """
    # `starts`, `ids` and `spans` are from `fill_tiles`.
    for t in tile_order(starts.shape[0] - 1, grid_x):
        left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
        _draw_tile(projected, ids, spans, starts[t], starts[t + 1], left, top, background, image, transmittance)
