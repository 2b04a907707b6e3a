"""Integer hash-grid lookup: which table rows an anchor reads, and the interpolated context (HACPP_SPEC 3)."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_BITS, CELL_BITS, UNIT_BITS
from splatwire.errors import InvalidValueError
from splatwire.model.config import PLANES, HashGridConfig

_MAX_UNIT = 2.0**62
_PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True)
class GridLevels:
    """All levels of the 3D table and the three planes, in the order of the context feature.

    Attributes:
        starts: First row of each level in the concatenated table.
        resolutions: Resolution of each level.
        rows: Rows of each level.
        axes: (levels, 3) world axes of each level; -1 in the last column for a plane.
    """

    starts: np.ndarray
    resolutions: np.ndarray
    rows: np.ndarray
    axes: np.ndarray

    @property
    def num_rows(self) -> int:
        """Rows of the concatenated table."""
        return int(self.rows.sum())


@functools.cache
def grid_levels(config: HashGridConfig) -> GridLevels:
    """Lays out the levels: the 3D table first, then the planes xy, xz, yz (HACPP_SPEC 3, output order)."""
    resolutions = list(config.resolutions_3d)
    rows = list(config.rows(3))
    axes = [(0, 1, 2)] * len(resolutions)
    for plane in PLANES:
        resolutions += config.resolutions_2d
        rows += config.rows(2)
        axes += [(*plane, -1)] * len(config.resolutions_2d)
    starts = np.concatenate([[0], np.cumsum(rows)[:-1]])
    return GridLevels(*(np.array(a, dtype=np.int64) for a in (starts, resolutions, rows, axes)))


def unit_coordinates(
    voxels: np.ndarray, voxel_size: float, bounds_min: np.ndarray, bounds_max: np.ndarray
) -> np.ndarray:
    """Maps voxel indices into the grid's box in fixed point.

    Slope and intercept are single correctly rounded float64 operations, the rest is integer arithmetic.

    Args:
        voxels: int64 (N, 3).
        voxel_size: World units per voxel.
        bounds_min: float32 (3), lower corner of the box.
        bounds_max: float32 (3), upper corner.

    Returns:
        int64 (N, 3), `UNIT_BITS` fractional bits; outside [0, 1] means outside the box.

    Raises:
        InvalidValueError: If the box is so thin that a position is no 64-bit number of its fractions.
    """
    units = np.empty(voxels.shape, dtype=np.int64)
    for axis in range(3):
        low, high = float(bounds_min[axis]), float(bounds_max[axis])
        width = max(high - low, 0.0) or math.nan
        factors = voxel_size / width * 2.0**UNIT_BITS, -low / width * 2.0**UNIT_BITS
        largest = int(np.abs(voxels[:, axis]).max(initial=0)) * abs(factors[0]) + abs(factors[1])
        if not largest < _MAX_UNIT:  # infinite, or not a number, too
            raise InvalidValueError(f"the grid's box from {low:g} to {high:g} is too thin for voxels of {voxel_size:g}")
        slope, intercept = (round(factor) for factor in factors)
        units[:, axis] = voxels[:, axis] * slope + intercept
    return units


def lookup(units: np.ndarray, signs: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Interpolates the grid at fixed-point positions.

    Args:
        units: int64 (N, 3) from `unit_coordinates`.
        signs: int8 (rows, D), all levels.
        config: Shape of the grid.

    Returns:
        float64 (N, H) holding whole numbers, `ACTIVATION_BITS` fractional bits.
    """
    from splatwire.codec.schemas.hacpp import _grid_kernels

    levels = grid_levels(config)
    out = np.empty((len(units), len(levels.rows) * config.features_per_level), dtype=np.float64)
    _grid_kernels.lookup(units, signs, levels.starts, levels.resolutions, levels.rows, levels.axes, out)
    return out


def touched_rows(units: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Tells which table rows the interpolation of any anchor reads; no other row needs to be sent.

    Args:
        units: int64 (N, 3) from `unit_coordinates`.
        config: Shape of the grid.

    Returns:
        bool (rows).
    """
    from splatwire.codec.schemas.hacpp import _grid_kernels

    levels = grid_levels(config)
    touched = np.zeros(levels.num_rows, dtype=np.bool_)
    _grid_kernels.touch(units, levels.starts, levels.resolutions, levels.rows, levels.axes, touched)
    return touched


def lookup_reference(units: np.ndarray, signs: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """The plain numpy form of `lookup`, corner by corner."""
    levels = grid_levels(config)
    blocks = []
    for start, resolution, rows, axes in zip(levels.starts, levels.resolutions, levels.rows, levels.axes, strict=True):
        used = [a for a in axes if a >= 0]
        at = units[:, used]
        inside = np.asarray(((at >= 0) & (at <= 1 << UNIT_BITS)).all(axis=1))
        scaled = (np.where(inside[:, None], at, 0) * (resolution - 2) + (1 << (UNIT_BITS - 1))) >> (
            UNIT_BITS - CELL_BITS
        )
        cell, fraction = scaled >> CELL_BITS, scaled & ((1 << CELL_BITS) - 1)
        total = np.zeros((len(units), signs.shape[1]), dtype=np.int64)
        weight_sum = np.zeros(len(units), dtype=np.int64)
        for corner in range(1 << len(used)):
            bits = np.array([(corner >> i) & 1 for i in range(len(used))])
            where = cell + bits
            along = np.where(bits == 1, fraction, (1 << CELL_BITS) - fraction)
            dropped = (where <= 0) | (where >= resolution - 1)
            weight = np.asarray(np.where(dropped, 0, along).prod(axis=1))
            total += weight[:, None] * signs[start + _rows_of(where, int(resolution), int(rows))]
            weight_sum += weight
        value = (total << ACTIVATION_BITS) // np.maximum(weight_sum, 1)[:, None]
        blocks.append(np.where(inside[:, None], value, 0))
    return np.concatenate(blocks, axis=1).astype(np.float64)


def _rows_of(corner: np.ndarray, resolution: int, rows: int) -> np.ndarray:
    dims = corner.shape[1]
    if resolution**dims <= rows:
        return (corner * resolution ** np.arange(dims)).sum(axis=1) % rows
    hashed = np.zeros(len(corner), dtype=np.uint64)
    for axis in range(dims):
        hashed ^= (corner[:, axis].astype(np.uint64) * np.uint64(_PRIMES[axis])) & np.uint64(0xFFFFFFFF)
    return (hashed % np.uint64(rows)).astype(np.int64)
