"""Numba kernels of the integer hash-grid lookup."""
# `tests/reference/hacpp_grid.py` is the same in numpy.

from typing import no_type_check

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_BITS, CELL_BITS, UNIT_BITS
from splatwire.ops.compiled import njit

PRIME_Y = 2654435761
PRIME_Z = 805459861
SHIFT = UNIT_BITS - CELL_BITS
ONE = 1 << UNIT_BITS
HALF = 1 << (UNIT_BITS - 1)
CELL = 1 << CELL_BITS


@njit(borrows=True)
@no_type_check
def row_of(x, y, z, resolution, rows, dims):
    """Returns the row of a grid point in the hash table of its level (HAC++).

    Args:
        x: First coordinate of the point, in grid points.
        y: Second coordinate.
        z: Third coordinate; 0 for a plane.
        resolution: Number of grid points per axis in this level of the hash grid.
        rows: Number of table rows of the level.
        dims: 3 for a level of the 3D grid, 2 for a level of a plane.
    """
    # The row is the index of the point if the level has at least one row for each point, else a hash of its
    # coordinates.
    stride = resolution * resolution if dims == 2 else resolution * resolution * resolution
    if stride <= rows:
        return (x + y * resolution + z * resolution * resolution) % rows
    hashed = np.uint32(x) ^ np.uint32(np.uint64(y) * np.uint64(PRIME_Y))
    if dims == 3:
        hashed ^= np.uint32(np.uint64(z) * np.uint64(PRIME_Z))
    return np.int64(hashed) % rows


@njit(borrows=True)
@no_type_check
def locate(unit, resolution):
    """Finds the cell of a grid that contains a coordinate, along one axis.

    Args:
        unit: Coordinate in the grid's bounding box, 0 to 1 in fixed point (`UNIT_BITS` fractional bits).
        resolution: Number of grid points per axis in this level of the hash grid.

    Returns:
        Index of the cell's lower corner, and the position within the cell, `CELL_BITS` fractional bits.
    """
    scaled = (unit * (resolution - 2) + HALF) >> SHIFT
    return scaled >> CELL_BITS, scaled & (CELL - 1)


@njit(borrows=True)
@no_type_check
def corner_weight(corner, bit, fraction, resolution):
    """Returns the interpolation weight of one of the two corners of a grid cell along one axis.

    Args:
        corner: Index of the cell's lower corner on this axis.
        bit: 0 for the lower corner, 1 for the upper.
        fraction: Position within the cell, `CELL_BITS` fractional bits.
        resolution: Number of grid points per axis in this level of the hash grid.
    """
    # The weight of corners on the border of the grid is 0.
    at = corner + bit
    if at <= 0 or at >= resolution - 1:
        return 0
    return fraction if bit else CELL - fraction


@njit(borrows=True, nogil=True)
@no_type_check
def inside_box(units, n, axes, grid_level, dims):
    """True if an anchor is inside the grid's bounding box on the axes that a level spans.

    Args:
        units: Positions of the anchors in the grid's bounding box, `UNIT_BITS` fractional bits.
        n: Index of the anchor.
        axes: World axes of each level, int64 (levels, 3).
        grid_level: Index of the level.
        dims: Number of axes: 3 for a level of the 3D grid, 2 for a level of a plane.
    """
    inside = True
    for a in range(dims):
        unit = units[n, axes[grid_level, a]]
        if unit < 0 or unit > ONE:
            inside = False
    return inside


@njit(borrows=True, nogil=True)
@no_type_check
def cell_of(units, n, axes, grid_level, dims, resolution):
    """Finds the cell that contains an anchor, in one level of the hash grid.

    Args:
        units: Positions of the anchors in the grid's bounding box, `UNIT_BITS` fractional bits.
        n: Index of the anchor.
        axes: World axes that each level spans, int64 (levels, 3); -1 in the last column for a plane.
        grid_level: Index of the level.
        dims: 3 for a level of the 3D grid, 2 for a level of a plane.
        resolution: Number of grid points per axis in this level of the hash grid.

    Returns:
        For each axis, index of the cell's lower corner and position within the cell.
    """
    x, fx = locate(units[n, axes[grid_level, 0]], resolution)
    y, fy = locate(units[n, axes[grid_level, 1]], resolution)
    z, fz = np.int64(0), np.int64(0)
    if dims == 3:
        z, fz = locate(units[n, axes[grid_level, 2]], resolution)
    return x, fx, y, fy, z, fz


@njit(nogil=True)
@no_type_check
def lookup(units, signs, starts, resolutions, rows, axes, out):
    """Interpolates every level of the hash grid for every anchor.

    Args:
        units: Positions of the anchors in the grid's bounding box, int64 (N, 3), `UNIT_BITS` fractional bits.
        signs: Hash tables of all levels, one after another, int8 (all rows, D), entries -1 or +1.
        starts: First table row of each level.
        resolutions: Resolution of each level, grid corners per axis.
        rows: Number of table rows of each level.
        axes: int64 (levels, 3), world axes that the level spans; -1 in the last column for a plane.
        out: Output: interpolated features, whole numbers with `ACTIVATION_BITS` fractional bits, float64 (N, levels *
            D).
    """
    features_per_level = signs.shape[1]
    total = np.zeros(8, np.int64)
    for n in range(units.shape[0]):
        for level in range(len(starts)):
            dims = 2 if axes[level, 2] < 0 else 3
            if not inside_box(units, n, axes, level, dims):
                for d in range(features_per_level):
                    out[n, level * features_per_level + d] = 0.0
                continue
            resolution, count, start = resolutions[level], rows[level], starts[level]
            x, fx, y, fy, z, fz = cell_of(units, n, axes, level, dims, resolution)
            for d in range(features_per_level):
                total[d] = 0
            weight_sum = np.int64(0)
            for corner in range(1 << dims):
                bx, by, bz = corner & 1, (corner >> 1) & 1, corner >> 2
                weight = corner_weight(x, bx, fx, resolution) * corner_weight(y, by, fy, resolution)
                if dims == 3:
                    weight *= corner_weight(z, bz, fz, resolution)
                if weight == 0:
                    continue
                weight_sum += weight
                row = start + row_of(x + bx, y + by, z + bz, resolution, count, dims)
                for d in range(features_per_level):
                    total[d] += weight * signs[row, d]
            for d in range(features_per_level):
                value = (total[d] << ACTIVATION_BITS) // weight_sum if weight_sum else np.int64(0)
                out[n, level * features_per_level + d] = value


@njit(borrows=True, nogil=True)
@no_type_check
def mark_rows(units, starts, resolutions, rows, axes, touched):
    """Marks the rows of the hash table that at least one anchor needs, in all levels of the hash grid.

    Args:
        units: Positions of the anchors in the grid's bounding box, int64 (N, 3), `UNIT_BITS` fractional bits.
        starts: First table row of each level.
        resolutions: Resolution of each level, grid corners per axis.
        rows: Number of table rows of each level.
        axes: int64 (levels, 3), world axes that the level spans; -1 in the last column for a plane.
        touched: Output: mask of the rows, bool (all rows).
    """
    for n in range(units.shape[0]):
        for level in range(len(starts)):
            dims = 2 if axes[level, 2] < 0 else 3
            if not inside_box(units, n, axes, level, dims):
                continue
            resolution, count, start = resolutions[level], rows[level], starts[level]
            x, fx, y, fy, z, fz = cell_of(units, n, axes, level, dims, resolution)
            for corner in range(1 << dims):
                bx, by, bz = corner & 1, (corner >> 1) & 1, corner >> 2
                weight = corner_weight(x, bx, fx, resolution) * corner_weight(y, by, fy, resolution)
                if dims == 3:
                    weight *= corner_weight(z, bz, fz, resolution)
                if weight:
                    touched[start + row_of(x + bx, y + by, z + bz, resolution, count, dims)] = True
