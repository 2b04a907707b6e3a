"""Compiled lists of the Gaussians in each tile, with the pixel rows that each Gaussian covers."""

# A Gaussian is listed in the tiles that contain a pixel of its ellipse of alpha >= 1/255. This is computed per column
# of tiles, which is tighter than the bounding box: a slanted Gaussian misses many tiles of its box. Results are the
# same as with `splatwire.neural.render.reference`.

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.lanes import prefetch
from splatwire.render._cpu_kernels import MIN_LOG_ALPHA, TILE
from splatwire.render._cpu_project import DEPTH, HALF_HEIGHT, PROJECTED_STRIDE, TILES

PREFETCH_DISTANCE = 16
TILE_BITS = np.int64(TILE.bit_length() - 1)
_EXPONENT_MARGIN = 1e-2  # margin of the exponent, far above rounding errors of the tile kernels
_MIN_EXPONENT = -200.0  # lower bound of exponents for any opacity


@njit(nogil=True, error_model="numpy")
@no_type_check
def count_row_pairs(tiles, grid_y):
    """Counts, for each row of tiles, how many pairs of a Gaussian and an overlapped tile are in this row.

    Args:
        tiles: Range of tiles of each Gaussian: left, top, right, bottom (exclusive).
        grid_y: Number of rows of tiles.
    """
    pairs = np.zeros(grid_y + 1, np.int64)
    for g in range(tiles.shape[0]):
        columns = tiles[g, 2] - tiles[g, 0]
        pairs[tiles[g, 1]] += columns
        pairs[tiles[g, 3]] -= columns
    return np.cumsum(pairs)[:-1]


@njit(nogil=True, error_model="numpy")
@no_type_check
def depth_order(projected, tiles, first_row, end_row):
    """Sorts the Gaussians in some rows of tiles by depth, nearest first.

    Args:
        projected: Projected Gaussians.
        tiles: Range of tiles of each Gaussian: left, top, right, bottom (exclusive).
        first_row: First row of tiles.
        end_row: End of the rows of tiles (exclusive).

    Returns:
        Indices of the Gaussians; and the number of tile columns that they overlap, summed over the Gaussians.
    """
    num, count, columns = tiles.shape[0], 0, np.int64(0)
    order, spare = np.empty(num, np.int32), np.empty(num, np.int32)
    keys, spare_keys = np.empty(num, np.uint32), np.empty(num, np.uint32)
    starts, mask = np.zeros((3, 2049), np.int64), np.uint32(2047)
    for g in range(num):
        if (tiles[g, 3] > first_row) & (tiles[g, 1] < end_row):
            key = np.float32(projected[g, DEPTH]).view(np.uint32)  # positive floats sort like their bits
            order[count], keys[count] = g, key
            count += 1
            columns += tiles[g, 2] - tiles[g, 0]
            for digit in range(3):
                starts[digit, np.int64((key >> np.uint32(11 * digit)) & mask) + 1] += 1
    for digit in range(3):
        for d in range(2048):
            starts[digit, d + 1] += starts[digit, d]
        for i in range(count):
            d = np.int64((keys[i] >> np.uint32(11 * digit)) & mask)
            at = starts[digit, d]
            spare[at], spare_keys[at] = order[i], keys[i]
            starts[digit, d] = at + 1
        order, spare, keys, spare_keys = spare, order, spare_keys, keys
    return order[:count], columns


@njit(inline="always", error_model="numpy")
@no_type_check
def _covered_rows(projected, g, left, columns, top, bottom, strips, strip):
    """Computes the pixel rows that a Gaussian covers in each column of tiles, and writes them to `strips`.

    Args:
        projected: Projected Gaussians.
        g: Index of the Gaussian.
        left: First column of tiles that the Gaussian overlaps.
        columns: Number of columns of tiles that it overlaps.
        top: First pixel row that may be written.
        bottom: End of the pixel rows that may be written (exclusive).
        strips: Output: first pixel row and end (exclusive), one row of this array for each column.
        strip: Row of `strips` for the column `left`.
    """
    # A Gaussian covers the pixels inside the ellipse with alpha >= 1/255. The rows range from the highest to the
    # lowest such pixel in the column. In a single column, the full height of the ellipse is used, which is faster
    # and adds few rows.
    y, first_pixel, end_pixel = np.float64(projected[g, 1]), np.float64(top), np.float64(bottom)
    if columns == 1:
        half_height = np.float64(projected[g, HALF_HEIGHT])
        strips[strip, 0], strips[strip, 1] = _rows_between(y - half_height, y + half_height, first_pixel, end_pixel)
        return
    A, B, C = np.float64(projected[g, 2]), np.float64(projected[g, 3]), np.float64(projected[g, 4])
    edge_exponent, discriminant = (
        max(MIN_LOG_ALPHA - _EXPONENT_MARGIN - projected[g, 5], _MIN_EXPONENT),
        B * B - 4 * A * C,
    )
    if not (discriminant < 0 and A < 0):  # not an ellipse because of rounding
        for i in range(strip, strip + columns):
            strips[i, 0], strips[i, 1] = top, bottom
        return
    lowest_dx, factor = B * np.sqrt(edge_exponent / (-A * discriminant)), -0.5 / C
    for i in range(columns):
        first = (left + i) * TILE - np.float64(projected[g, 0])
        low_dx, high_dx = min(max(-lowest_dx, first), first + TILE - 1), min(max(lowest_dx, first), first + TILE - 1)
        low_square, high_square = (
            discriminant * low_dx * low_dx + 4 * C * edge_exponent,
            discriminant * high_dx * high_dx + 4 * C * edge_exponent,
        )
        begin, end = np.int32(0), np.int32(0)
        if low_square >= 0 and high_square >= 0:
            low = y + factor * (B * low_dx - np.sqrt(low_square))
            high = y + factor * (B * high_dx + np.sqrt(high_square))
            begin, end = _rows_between(low, high, first_pixel, end_pixel)
        strips[strip + i, 0], strips[strip + i, 1] = begin, end


@njit(inline="always")
@no_type_check
def _rows_between(low, high, top, bottom):
    """Returns the first pixel row and the end (exclusive) of the rows from `low` to `high`, within `top` to `bottom`.

    Args:
        low: Smallest row coordinate, pixels; may be fractional.
        high: Largest row coordinate, pixels.
        top: First row of the limits.
        bottom: End of the limits (exclusive).
    """
    first, last = np.ceil(min(max(low, top), bottom)), np.floor(min(max(high, top - 1.0), bottom - 1.0))
    return np.int32(first), np.int32(last) + np.int32(1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def fill_tiles(projected, order, num_columns, grid_x, first_row, end_row):
    """Lists the Gaussians that each tile draws, nearest first, for some rows of tiles.

    Args:
        projected: Projected Gaussians.
        order: Indices of the Gaussians to list, nearest first.
        num_columns: Sum, over all Gaussians, of the number of tile columns that the Gaussian overlaps.
        grid_x: Number of tile columns of the image.
        first_row: First row of tiles.
        end_row: End of the rows of tiles (exclusive).

    Returns:
        Five arrays:

        * Start of each tile's list in the second array, and the end of the last list.
        * Lists of all tiles, one after another: indices of Gaussians.
        * Pixel rows that each entry of the second array covers in its tile: first row and end (exclusive).
        * Positions in the second array, sorted by Gaussian: all positions of the first Gaussian of `order`, then those
          of the second, and so on.
        * Start of each Gaussian's positions in the fourth array, in the order of `order`, and the end of the last.
    """
    # Rows are shifted instead of divided, and array views (reference-counted) are avoided: together this halves the
    # time.
    strips, starts = np.empty((num_columns, 2), np.int32), np.zeros((end_row - first_row) * grid_x + 1, np.int64)
    corners = np.empty((order.shape[0], 2), np.int32)  # tile of the first column in the first row; number of columns
    entry_starts, entry, strip = np.zeros(order.shape[0] + 1, np.int64), 0, 0
    for k in range(order.shape[0]):
        if k + PREFETCH_DISTANCE < order.shape[0]:
            prefetch(projected, np.int64(order[k + PREFETCH_DISTANCE]) * PROJECTED_STRIDE)
        g = np.int64(order[k])
        left = np.int64(projected[g, TILES])
        columns, corner = np.int64(projected[g, TILES + 2]) - left, left - first_row * grid_x
        top = max(np.int64(projected[g, TILES + 1]), first_row) * TILE
        bottom = min(np.int64(projected[g, TILES + 3]), end_row) * TILE
        _covered_rows(projected, g, left, columns, top, bottom, strips, strip)
        corners[k, 0], corners[k, 1] = corner, columns
        for i in range(columns):
            low, high = _tile_rows(strips[strip + i, 0], strips[strip + i, 1])
            tile = corner + i + low * grid_x + 1
            for _ in range(low, high):
                starts[tile] += 1
                tile += grid_x
            entry += high - low
        strip += columns
        entry_starts[k + 1] = entry
    for t in range(starts.shape[0] - 1):
        starts[t + 1] += starts[t]
    return starts, *_build_tile_lists(order, corners, strips, starts, grid_x), entry_starts


@njit(inline="always", error_model="numpy")
@no_type_check
def _build_tile_lists(order, corners, strips, starts, grid_x):
    """Lists the Gaussians of each tile, nearest first, from the pixel rows that each Gaussian covers.

    Args:
        order: Indices of the Gaussians, nearest first.
        corners: One row for each Gaussian of `order`: index of a tile, and number of tile columns that the Gaussian
            overlaps. The tile is in the first of these columns and in tile row 0 of the image. Index 0 is the first
            listed tile, so the index can be negative.
        strips: First pixel row and end (exclusive) that a Gaussian covers in a tile column. The rows of this array are
            the tile columns of the first Gaussian, then those of the second, and so on.
        starts: Start of each tile's list in the result, and the total length.
        grid_x: Number of tile columns of the image.

    Returns:
        The second, third and fourth array of the result of `fill_tiles`: lists of all tiles, pixel rows that each entry
        covers, and positions sorted by Gaussian.
    """
    num, heads, entry, strip = starts[-1], starts[:-1].copy(), 0, 0
    ids, spans, entries = np.empty(num, np.int32), np.empty((num, 2), np.uint8), np.empty(num, np.int32)
    for k in range(order.shape[0]):
        for i in range(np.int64(corners[k, 1])):
            top, bottom = np.int64(strips[strip, 0]), np.int64(strips[strip, 1])
            low, high = _tile_rows(top, bottom)
            tile = np.int64(corners[k, 0]) + i + low * grid_x
            for ty in range(low, high):
                at = heads[tile]
                heads[tile] = at + 1
                ids[at], entries[entry] = order[k], at
                spans[at, 0], spans[at, 1] = max(top - ty * TILE, 0), min(bottom - ty * TILE, TILE)
                entry += 1
                tile += grid_x
            strip += 1
    return ids, spans, entries


@njit(inline="always")
@no_type_check
def _tile_rows(top, bottom):
    """Returns the rows of tiles that contain the pixel rows from `top` to `bottom` (exclusive), as a range."""
    low = np.int64(top) >> TILE_BITS
    return low, (np.int64(bottom) + TILE - 1) >> TILE_BITS if bottom > top else low
