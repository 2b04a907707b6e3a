"""Compiled kernel that measures the picture error of removing each Gaussian.

The kernel blends the Gaussians of each tile a second time, as the gradient does (`splatwire.render._cpu_gradients`).
"""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.lanes import choose, load, pairs, power_of_two, smaller, spread, store, store_first
from splatwire.render._cpu_kernels import (
    AHEAD,
    LIVE,
    MAX_LEVEL,
    MIN_LEVEL,
    MIN_TRANSMITTANCE,
    ONE,
    PIXELS,
    TILE,
    ZERO,
    finished,
    prefetch_splat,
    splat_numbers,
)

NUM_EFFECTS = 3
"""Number of sums per Gaussian: D D and R D over all pixels and channels, and w w over all pixels. D is what the
Gaussian adds to the picture, R the difference of the picture from the reference, w the weight of its colour."""
# Sections of a tile's buffer: transmittance, colour that later Gaussians add, difference from the reference; columns.
_REST_R, _REST_G, _REST_B, _OFF_R, _OFF_G, _OFF_B, _COLUMN = (k * PIXELS for k in range(1, 8))


@njit(borrows=True, inline="never", error_model="numpy")
@no_type_check
def _measure(buf, low, high, x, y, A, B, C, log_opacity, red, green, blue, out, row):
    """Measures the effect of one Gaussian on a few pixel rows of one image tile.

    Args:
        buf: Pixel buffer of the tile; changed in place.
        low: First pixel row.
        high: End of the pixel rows (exclusive).
        x: Centre of the Gaussian in the tile, pixels.
        y: Centre of the Gaussian in the tile, pixels.
        A: Coefficient of dx ** 2 in the exponent of alpha (base 2).
        B: Coefficient of dx * dy.
        C: Coefficient of dy ** 2.
        log_opacity: log2 of the opacity.
        red: Colour of the Gaussian.
        green: Colour of the Gaussian.
        blue: Colour of the Gaussian.
        out: Output: sums, one row for each pair of Gaussian and tile.
        row: Row of `out` to write.
    """
    # Without the Gaussian, the colour that later Gaussians and the background add is divided by 1 - alpha.
    dx = load(buf, _COLUMN) - x
    still, slope = dx * dx * A + log_opacity, dx * B
    dy = spread(np.float32(low) - y)
    most, zero = spread(min(log_opacity, MAX_LEVEL)), spread(ZERO)
    own = cross = weights = zero
    for i in range(low * TILE, high * TILE, TILE):
        power = still + (slope + dy * C) * dy
        dy += ONE
        alpha = power_of_two(smaller(power, most))
        live = load(buf, i + LIVE)
        weight = choose(power >= MIN_LEVEL, alpha * live, zero)
        after = live - weight
        drawn = after >= MIN_TRANSMITTANCE
        weight = choose(drawn, weight, zero)
        store(buf, i + LIVE, choose(drawn, after, zero))
        hides = choose(drawn & (power >= MIN_LEVEL), alpha / (ONE - alpha), zero)
        own_r, own_g, own_b = weight * red, weight * green, weight * blue
        rest_r = load(buf, i + _REST_R) - own_r
        rest_g = load(buf, i + _REST_G) - own_g
        rest_b = load(buf, i + _REST_B) - own_b
        store(buf, i + _REST_R, rest_r)
        store(buf, i + _REST_G, rest_g)
        store(buf, i + _REST_B, rest_b)
        d_r, d_g, d_b = own_r - rest_r * hides, own_g - rest_g * hides, own_b - rest_b * hides
        own += d_r * d_r + d_g * d_g + d_b * d_b
        cross += d_r * load(buf, i + _OFF_R) + d_g * load(buf, i + _OFF_G) + d_b * load(buf, i + _OFF_B)
        weights += weight * weight
    sums = pairs(pairs(own, cross), pairs(weights, weights))
    sums = pairs(sums, sums)
    sums = pairs(sums, sums)
    store_first(out, row * NUM_EFFECTS, sums, NUM_EFFECTS)


@njit(error_model="numpy")
@no_type_check
def _measure_tile(splats, ids, spans, begin, end, left, top, image, difference, rows_of_sums):
    height, width = image.shape[:2]
    size = _COLUMN + TILE
    whole = np.zeros(size + TILE, np.float32)
    first = -whole.ctypes.data % 64 // 4  # pixel rows are aligned to cache lines
    buf = whole[first : first + size]
    for column in range(TILE):
        buf[_COLUMN + column] = column
    for row in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            i = row * TILE + column
            buf[LIVE + i] = 1.0
            for c in range(3):
                buf[_REST_R + c * PIXELS + i] = image[top + row, left + column, c]
                buf[_OFF_R + c * PIXELS + i] = difference[top + row, left + column, c]
    for k in range(begin, end):
        prefetch_splat(splats, ids, k + AHEAD)
        x, y, A, B, C, level, red, green, blue = splat_numbers(splats, ids[k], left, top)
        low, high = np.int64(spans[k, 0]), np.int64(spans[k, 1])
        _measure(buf, low, high, x, y, A, B, C, level, red, green, blue, rows_of_sums, k)
        if (k - begin) % 16 == 15 and finished(buf):
            break


@njit(nogil=True, error_model="numpy")
@no_type_check
def measure_tiles(splats, starts, ids, spans, grid_x, first_row, image, difference, rows_of_sums, sums):
    """Measures the effect of each projected Gaussian on some rows of tiles of the image.

    Args:
        splats: Projected Gaussians.
        starts: Start of each tile's list of Gaussians.
        ids: Lists of the Gaussians of each tile.
        spans: Pixel rows that the Gaussian of each list entry covers.
        grid_x: Number of tile columns.
        first_row: First row of tiles.
        image: The rendered image.
        difference: Difference of the image from its reference.
        rows_of_sums: Buffer for the sums of each pair of Gaussian and tile, zeros.
        sums: The three sums of each Gaussian (`NUM_EFFECTS`), increased in place.
    """
    # `starts`, `ids` and `spans` are from `fill_tiles`.
    for t in range(starts.shape[0] - 1):
        left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
        _measure_tile(splats, ids, spans, starts[t], starts[t + 1], left, top, image, difference, rows_of_sums)
    for k in range(ids.shape[0]):
        for c in range(NUM_EFFECTS):
            sums[ids[k], c] += rows_of_sums[k * NUM_EFFECTS + c]
