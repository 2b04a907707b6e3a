"""Binary hash grid in floating point, for training."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.types.anchor_scene import HashGrid

_PRIMES = (1, 2654435761, 805459861)


def unit_coordinates(grid: HashGrid, positions: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Maps world coordinates to coordinates relative to the grid's bounding box, [0, 1] inside the box."""
    return (positions - grid.bounds_min) / (grid.bounds_max - grid.bounds_min)


def corner_rows(
    unit: Float[Tensor, "N dims"], resolution: int, num_rows: int
) -> tuple[Int64[Tensor, "N corners"], Float[Tensor, "N corners"]]:
    """Finds the grid points around each position on one level of the hash grid, and their interpolation weights.

    Args:
        unit: Positions relative to the bounding box, [0, 1] per axis inside the box.
        resolution: Number of grid points of the level per axis.
        num_rows: Number of table rows of the level.

    Returns:
        Row indices within the level, and interpolation weights, of the corners of the grid cell around each position.
        Corners are ordered so that the coordinate along the first axis changes fastest. Outside the box, all weights
        are 0.
    """
    # Points on the border of the level have weight 0, and the other weights add up to 1. Outside the box, all
    # weights are 0.
    inside = ((unit >= 0) & (unit <= 1)).all(dim=1, keepdim=True)
    position = torch.where(inside, unit, 0.5) * (resolution - 2) + 0.5
    cell = position.floor()
    fraction = position - cell
    grid_points = torch.stack([cell, cell + 1], dim=2)
    # the weight of a corner and the sum of all weights are products over the axes: each axis can be normalised
    # separately
    weights = torch.stack([1 - fraction, fraction], dim=2) * ((grid_points > 0) & (grid_points < resolution - 1))
    weights = weights / weights.sum(dim=2, keepdim=True).clamp(min=1e-9) * inside[:, :, None]
    terms = _row_terms(grid_points.to(torch.int64), resolution, num_rows)
    dense = _is_dense(resolution, unit.shape[1], num_rows)
    rows, weight = terms[:, 0], weights[:, 0]
    for axis in range(1, unit.shape[1]):
        term = terms[:, axis, :, None]
        rows = (rows[:, None] + term if dense else rows[:, None] ^ term).flatten(1)
        weight = (weight[:, None] * weights[:, axis, :, None]).flatten(1)
    if not dense:
        rows = rows % num_rows if num_rows & (num_rows - 1) else rows & (num_rows - 1)
    return rows, weight


def _is_dense(resolution: int, dims: int, num_rows: int) -> bool:
    """True if the table of a grid level has a row for every grid point, so that grid points need not be hashed."""
    return resolution**dims <= num_rows


def _row_terms(corners: Int64[Tensor, "N dims 2"], resolution: int, num_rows: int) -> Int64[Tensor, "N dims 2"]:
    """Computes the contribution of each axis to the table row indices of the neighbouring grid points.

    The row index of a grid point is the sum of the contributions of all axes. If grid points are hashed, it is their
    XOR, modulo the number of rows.

    Args:
        corners: Coordinates of the lower and the upper neighbouring grid point along each axis.
        resolution: Number of grid points along each axis.
        num_rows: Number of rows of the table.
    """
    dims = corners.shape[1]
    strides = [resolution**d for d in range(dims)]
    factors = strides if _is_dense(resolution, dims, num_rows) else list(_PRIMES[:dims])
    return (corners * torch.tensor(factors, dtype=torch.int64, device=corners.device)[:, None]) & 0xFFFFFFFF
