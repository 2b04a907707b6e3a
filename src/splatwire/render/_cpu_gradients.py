"""Compiled gradient of the tile rasteriser."""

# The backward pass blends the Gaussians of each tile a second time, nearest first, and sums the gradients of each
# Gaussian over the pixels. The sums of a Gaussian in one tile are stored as a separate array row. Rows are added in a
# fixed order, so the gradient does not depend on the number of threads.

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.lanes import (
    LANES,
    choose,
    load,
    pairs,
    power_of_two,
    prefetch,
    smaller,
    spread,
    store,
    store_first,
)
from splatwire.render._cpu_kernels import (
    BLUE,
    COLUMN,
    GREEN,
    MAX_LOG_ALPHA,
    MIN_LOG_ALPHA,
    MIN_TRANSMITTANCE,
    ONE,
    PIXELS,
    PREFETCH_DISTANCE,
    RED,
    REST,
    TILE,
    TRANSMITTANCE,
    ZERO,
    finished,
    new_buffer,
    prefetch_projected,
    read_projected,
)

SUMS = 9
"""Number of gradient sums per Gaussian: h, h dx, h dy, h dx^2, h dx dy, h dy^2, where h is the gradient of the
falloff's exponent at a pixel and (dx, dy) the offset from the 2D centre; and the gradient of RGB."""
SPARE = LANES - SUMS
"""Number of padding values after the last array row of sums, because rows are read sixteen values at a time."""
_PREFETCH_ROWS = 16


@njit(borrows=True, inline="never", error_model="numpy")
@no_type_check
def _blend_back(buf, low, high, x, y, A, B, C, log_opacity, red, green, blue, out, row):
    """Computes the gradient of the loss with respect to one Gaussian from a few pixel rows of one image tile.

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
        out: Output: gradient sums, one row for each pair of Gaussian and tile.
        row: Row of `out` to write.
    """
    # The caller passes the Gaussians of the tile one after another in drawing order.
    # The colour behind a Gaussian is the finished image minus everything blended so far. Sums are accumulated per pixel
    # column, and multiplied at the end by dx, the column's distance from the centre.
    dx = load(buf, COLUMN) - x
    constant, slope = dx * dx * A + log_opacity, dx * B
    dy = spread(np.float32(low) - y)
    max_exponent, zero = spread(min(log_opacity, MAX_LOG_ALPHA)), spread(ZERO)
    h0 = h1 = h2 = sum_r = sum_g = sum_b = zero
    for i in range(low * TILE, high * TILE, TILE):
        power = constant + (slope + dy * C) * dy
        alpha = power_of_two(smaller(power, max_exponent))
        transmittance = load(buf, i + TRANSMITTANCE)
        weight = choose(power >= MIN_LOG_ALPHA, alpha * transmittance, zero)
        after = transmittance - weight
        drawn = after >= MIN_TRANSMITTANCE
        weight = choose(drawn, weight, zero)
        store(buf, i + TRANSMITTANCE, choose(drawn, after, zero))
        d_r, d_g, d_b = load(buf, i + RED), load(buf, i + GREEN), load(buf, i + BLUE)
        own = weight * (d_r * red + d_g * green + d_b * blue)
        rest = load(buf, i + REST) - own
        store(buf, i + REST, rest)
        moved = drawn & (power >= MIN_LOG_ALPHA) & (power <= MAX_LOG_ALPHA)
        h = choose(moved, own - rest * (alpha / (ONE - alpha)), zero)
        h_dy = h * dy
        h0 += h
        h1 += h_dy
        h2 += h_dy * dy
        sum_r += weight * d_r
        sum_g += weight * d_g
        sum_b += weight * d_b
        dy += ONE
    h0_dx = h0 * dx
    quarter = pairs(pairs(h0, h0_dx), pairs(h1, h0_dx * dx))
    next_quarter = pairs(pairs(h1 * dx, h2), pairs(sum_r, sum_g))
    last = pairs(sum_b, sum_b)
    last = pairs(last, last)
    store_first(out, row * SUMS, pairs(pairs(quarter, next_quarter), pairs(last, last)), SUMS)


@njit(error_model="numpy")
@no_type_check
def _tile_back(projected, ids, spans, begin, end, left, top, image, d_image, rows_of_sums):
    height, width = image.shape[:2]
    rows, columns = min(TILE, height - top), min(TILE, width - left)
    buf = new_buffer(columns, rows)
    for row in range(rows):
        for column in range(columns):
            i = row * TILE + column
            rest = np.float32(0)
            for c in range(3):
                d = d_image[top + row, left + column, c]
                buf[i + RED + c * PIXELS] = d
                rest += d * image[top + row, left + column, c]
            buf[i + REST] = rest
    for k in range(begin, end):
        prefetch_projected(projected, ids, k + PREFETCH_DISTANCE)
        x, y, A, B, C, log_opacity, red, green, blue = read_projected(projected, ids[k], left, top)
        low, high = np.int64(spans[k, 0]), np.int64(spans[k, 1])
        _blend_back(buf, low, high, x, y, A, B, C, log_opacity, red, green, blue, rows_of_sums, k)
        if (k - begin) % 16 == 15 and finished(buf):
            break


@njit(nogil=True, error_model="numpy")
@no_type_check
def draw_tiles_back(projected, starts, ids, spans, grid_x, first_row, image, d_image, rows_of_sums, first, last):
    """Computes the gradient of the loss with respect to each projected Gaussian, in some tiles of the image.

    Args:
        projected: Projected Gaussians.
        starts: Start of each tile's list in `ids`, and the end of the last list.
        ids: Lists of all tiles, one after another: indices of Gaussians, nearest first.
        spans: Pixel rows that each entry of `ids` covers in its tile: first row and end (exclusive).
        grid_x: Number of tile columns.
        first_row: First row of tiles.
        image: The rendered image.
        d_image: Gradient of the loss with respect to the image.
        rows_of_sums: Output: gradient sums of each pair of Gaussian and tile.
        first: Index of the first tile.
        last: End of the tiles (exclusive).
    """
    # `starts`, `ids` and `spans` are from `fill_tiles`. `rows_of_sums` must be zero before.
    for t in range(first, last):
        left, top = (t % grid_x) * TILE, (first_row + t // grid_x) * TILE
        _tile_back(projected, ids, spans, starts[t], starts[t + 1], left, top, image, d_image, rows_of_sums)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def add_rows(rows_of_sums, gaussian_indices, pair_rows, pair_starts, sums):
    """Sums the gradients of each Gaussian over its tiles, and adds the results to `sums`.

    Args:
        rows_of_sums: Gradients, one row for each pair of Gaussian and tile, from `draw_tiles_back`.
        gaussian_indices: Entry k is the row of the k-th Gaussian in `sums`.
        pair_rows: Rows of `rows_of_sums`: all rows of the first Gaussian, then those of the second, and so on.
        pair_starts: Start of each Gaussian's rows in `pair_rows`, and the end of the last. The rows of the k-th
            Gaussian are `pair_rows[pair_starts[k]:pair_starts[k + 1]]`.
        sums: Gradient of each Gaussian, changed in place.
    """
    # The sums are from `draw_tiles_back`, `pair_rows` and `pair_starts` from `fill_tiles`. The order of addition is
    # that of the tiles.
    for k in range(gaussian_indices.shape[0]):
        first = np.int64(gaussian_indices[k]) * SUMS
        added = load(sums, first)
        for place in range(pair_starts[k], pair_starts[k + 1]):
            if place + _PREFETCH_ROWS < pair_rows.shape[0]:
                prefetch(rows_of_sums, np.int64(pair_rows[place + _PREFETCH_ROWS]) * SUMS)
            added += load(rows_of_sums, np.int64(pair_rows[place]) * SUMS)
        store_first(sums, first, added, SUMS)
