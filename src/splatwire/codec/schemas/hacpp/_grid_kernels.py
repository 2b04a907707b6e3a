"""Numba kernels of the integer hash-grid lookup; `tests/reference/hacpp_grid.py` says the same in numpy."""

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
    """Row of a grid corner in its level's table: dense where the level fits, hashed elsewhere (HAC++, hash grid)."""
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
    """Lower corner and fraction (`CELL_BITS` bits) of a unit coordinate on one axis of a level."""
    scaled = (unit * (resolution - 2) + HALF) >> SHIFT
    return scaled >> CELL_BITS, scaled & (CELL - 1)


@njit(borrows=True)
@no_type_check
def corner_weight(corner, bit, fraction, resolution):
    """Weight of one axis of a corner; zero where the corner lies on the border and is dropped."""
    at = corner + bit
    if at <= 0 or at >= resolution - 1:
        return 0
    return fraction if bit else CELL - fraction


@njit(borrows=True, nogil=True)
@no_type_check
def inside_box(units, n, axes, level, dims):
    """Tells whether an anchor lies in the box on every axis of a level."""
    inside = True
    for a in range(dims):
        unit = units[n, axes[level, a]]
        if unit < 0 or unit > ONE:
            inside = False
    return inside


@njit(borrows=True, nogil=True)
@no_type_check
def cell_of(units, n, axes, level, dims, resolution):
    """Lower corner and fractions of an anchor's cell in a level; zero on the axis that a plane does not have."""
    x, fx = locate(units[n, axes[level, 0]], resolution)
    y, fy = locate(units[n, axes[level, 1]], resolution)
    z, fz = np.int64(0), np.int64(0)
    if dims == 3:
        z, fz = locate(units[n, axes[level, 2]], resolution)
    return x, fx, y, fy, z, fz


@njit(nogil=True)
@no_type_check
def lookup(units, signs, starts, resolutions, rows, axes, out):
    """Interpolates every level for every anchor.

    Args:
        units: int64 (N, 3), `UNIT_BITS` fractional bits.
        signs: int8 (all rows, D).
        starts: First row of each level.
        resolutions: Resolution of each level.
        rows: Rows of each level.
        axes: int64 (levels, 3): the axes of the level, -1 for none.
        out: float64 (N, levels * D), written with whole numbers, `ACTIVATION_BITS` fractional bits.
    """
    depth = signs.shape[1]
    total = np.zeros(8, np.int64)
    for n in range(units.shape[0]):
        for level in range(len(starts)):
            dims = 2 if axes[level, 2] < 0 else 3
            if not inside_box(units, n, axes, level, dims):
                for d in range(depth):
                    out[n, level * depth + d] = 0.0
                continue
            resolution, count, start = resolutions[level], rows[level], starts[level]
            x, fx, y, fy, z, fz = cell_of(units, n, axes, level, dims, resolution)
            for d in range(depth):
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
                for d in range(depth):
                    total[d] += weight * signs[row, d]
            for d in range(depth):
                value = (total[d] << ACTIVATION_BITS) // weight_sum if weight_sum else np.int64(0)
                out[n, level * depth + d] = value


@njit(borrows=True, nogil=True)
@no_type_check
def touch(units, starts, resolutions, rows, axes, touched):
    """Marks every table row that some anchor's interpolation reads with a weight above zero."""
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
