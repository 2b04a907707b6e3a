"""Integer hash-grid lookup (HAC++): table rows that an anchor reads, and the features interpolated from them."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from splatwire.codec.anchors.hacpp import _grid_kernels
from splatwire.codec.fixed_point import UNIT_BITS
from splatwire.errors import InvalidValueError
from splatwire.types.anchor_config import PLANES, HashGridConfig

_MAX_UNIT = 2.0**62
_PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True)
class GridLevels:
    """Layout of the hash table with all levels of HAC++'s grid: 3D levels first, then the levels of three planes.

    Attributes:
        starts: First table row of each level.
        resolutions: Resolution of each level.
        rows: Number of table rows of each level.
        axes: (levels, 3) world axes of each level; -1 in the last column for a plane.
    """

    starts: np.ndarray
    resolutions: np.ndarray
    rows: np.ndarray
    axes: np.ndarray

    @property
    def num_rows(self) -> int:
        """Number of rows of the table."""
        return int(self.rows.sum())


@functools.cache
def grid_levels(config: HashGridConfig) -> GridLevels:
    """Returns the layout of the table that contains all levels of the hash grid."""
    # The levels of the 3D grid are first, then those of the planes xy, xz and yz, as in HAC++.
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
    """Converts voxels to fixed-point coordinates within the grid's bounding box, identically on every machine.

    Args:
        voxels: Positions of N anchors in voxels, int64 (N, 3).
        voxel_size: World units per voxel.
        bounds_min: Lower corner of the box, world units, float32 (3).
        bounds_max: Upper corner of the box, world units, float32 (3).

    Returns:
        Coordinates, int64 (N, 3), `UNIT_BITS` fractional bits. Points inside the box have coordinates from 0 to 1.
        Points outside have coordinates beyond this range.

    Raises:
        InvalidValueError: If the box is too thin for 64-bit coordinates.
    """
    # The conversion is a linear function. Its two coefficients are computed in float64 with one rounding each; the rest
    # is integer arithmetic.
    units = np.empty(voxels.shape, dtype=np.int64)
    for axis in range(3):
        low, high = float(bounds_min[axis]), float(bounds_max[axis])
        width = max(high - low, 0.0) or math.nan
        factors = voxel_size / width * 2.0**UNIT_BITS, -low / width * 2.0**UNIT_BITS
        largest = int(np.abs(voxels[:, axis]).max(initial=0)) * abs(factors[0]) + abs(factors[1])
        if not largest < _MAX_UNIT:  # also rejects infinity and NaN
            raise InvalidValueError(f"the grid's box from {low:g} to {high:g} is too thin for voxels of {voxel_size:g}")
        slope, intercept = (round(factor) for factor in factors)
        units[:, axis] = voxels[:, axis] * slope + intercept
    return units


def lookup(units: np.ndarray, signs: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Interpolates the hash grid at given positions.

    Args:
        units: Positions from `unit_coordinates`, int64 (N, 3).
        signs: The hash tables of all levels, entries -1 or +1, int8 (rows, D).
        config: Resolutions and table sizes of the hash grid.

    Returns:
        Hash-grid features, float64 (N, H), whole numbers with `ACTIVATION_BITS` fractional bits.
    """
    levels = grid_levels(config)
    out = np.empty((len(units), len(levels.rows) * config.features_per_level), dtype=np.float64)
    _grid_kernels.lookup(units, signs, levels.starts, levels.resolutions, levels.rows, levels.axes, out)
    return out


def touched_rows(units: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Returns the mask of the hash-table rows that at least one anchor reads.

    Args:
        units: Positions of the anchors from `unit_coordinates`, int64 (N, 3).
        config: Resolutions and table sizes of the hash grid.

    Returns:
        Mask of the rows, bool (rows).
    """
    # The stream contains only these rows.
    levels = grid_levels(config)
    touched = np.zeros(levels.num_rows, dtype=np.bool_)
    _grid_kernels.mark_rows(units, levels.starts, levels.resolutions, levels.rows, levels.axes, touched)
    return touched
