"""The binary hash grid in floats: the oracle of the codec's integer lookup, and what training differentiates."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import embedding_bag

from splatwire.model.anchor_scene import HashGrid
from splatwire.model.config import PLANES, HashGridConfig

_PRIMES = (1, 2654435761, 805459861)
_CHUNK = 32768


@torch.no_grad()
def interpolate_hash_grid(
    grid: HashGrid, positions: Float[Tensor, "N 3"], config: HashGridConfig
) -> Float[Tensor, "N H"]:
    """Interpolates the signs of `grid` at anchor positions, in chunks (HAC++, hash grid).

    Args:
        grid: The tables and the box that they fill.
        positions: World coordinates.
        config: Shape of the grid.

    Returns:
        The levels of the 3D table, then those of the planes xy, xz and yz; zero where a position is outside the box.
    """
    dtype = positions.dtype
    volume, planes = grid.volume.to(dtype), grid.planes.to(dtype)
    out = positions.new_empty(len(positions), config.context_dim)
    for start in range(0, len(positions), _CHUNK):
        unit = unit_coordinates(grid, positions[start : start + _CHUNK])
        out[start : start + _CHUNK] = interpolate_tables(volume, planes, unit, config)
    return out


def unit_coordinates(grid: HashGrid, positions: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Maps world coordinates to the box of the grid, [0, 1] per axis inside."""
    return (positions - grid.bounds_min) / (grid.bounds_max - grid.bounds_min)


def interpolate_tables(
    volume: Float[Tensor, "rows3 D"],
    planes: Float[Tensor, "3 rows2 D"],
    unit: Float[Tensor, "N 3"],
    config: HashGridConfig,
) -> Float[Tensor, "N H"]:
    """Interpolates float tables; differentiable in the tables.

    Args:
        volume: The 3D table, all levels.
        planes: The tables of the three planes, all levels.
        unit: Positions in the box, [0, 1] per axis inside.
        config: Shape of the grid.
    """
    features = [_interpolate_levels(volume, unit, config.resolutions_3d, config.rows(3))]
    for table, axes in zip(planes, PLANES, strict=True):
        features.append(_interpolate_levels(table, unit[:, axes], config.resolutions_2d, config.rows(2)))
    return torch.cat(features, dim=1)


def corner_rows(
    unit: Float[Tensor, "N dims"], resolution: int, num_rows: int
) -> tuple[Int64[Tensor, "N corners"], Float[Tensor, "N corners"]]:
    """Finds the table rows around each position and their multilinear weights on one level (HAC++, hash grid).

    Corners on the rim of the level (coordinate 0 or resolution - 1) do not count; the weights of the others are
    divided by their sum, so that they add up to 1 inside the box. Outside of it all weights are 0.

    Args:
        unit: Positions in the box.
        resolution: Grid resolution of the level.
        num_rows: Rows of the level.

    Returns:
        Rows within the level, and weights; the first axis runs fastest over the corners.
    """
    inside = ((unit >= 0) & (unit <= 1)).all(dim=1, keepdim=True)
    place = torch.where(inside, unit, 0.5) * (resolution - 2) + 0.5
    cell = place.floor()
    fraction = place - cell
    at = torch.stack([cell, cell + 1], dim=2)
    # The weight of a corner is a product over the axes, so is the sum of all: each axis is normalised alone.
    weights = torch.stack([1 - fraction, fraction], dim=2) * ((at > 0) & (at < resolution - 1))
    weights = weights / weights.sum(dim=2, keepdim=True).clamp(min=1e-9) * inside[:, :, None]
    terms = _row_terms(at.to(torch.int64), resolution, num_rows)
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
    """Tells whether every point of a level has a row of its own."""
    return resolution**dims <= num_rows


def _row_terms(at: Int64[Tensor, "N dims 2"], resolution: int, num_rows: int) -> Int64[Tensor, "N dims 2"]:
    """What each axis contributes to a row number: summands where a level is dense, otherwise parts of an XOR hash."""
    dims = at.shape[1]
    strides = [resolution**d for d in range(dims)]
    factors = strides if _is_dense(resolution, dims, num_rows) else list(_PRIMES[:dims])
    return (at * torch.tensor(factors, dtype=torch.int64, device=at.device)[:, None]) & 0xFFFFFFFF


def _interpolate_levels(
    table: Float[Tensor, "rows D"],
    unit: Float[Tensor, "N dims"],
    resolutions: Sequence[int],
    rows_per_level: Sequence[int],
) -> Float[Tensor, "N _"]:
    levels = []
    start = 0
    for resolution, num_rows in zip(resolutions, rows_per_level, strict=True):
        rows, weights = corner_rows(unit, resolution, num_rows)
        level = table[start : start + num_rows]
        levels.append(embedding_bag(rows, level, mode="sum", per_sample_weights=weights))
        start += num_rows
    return torch.cat(levels, dim=1)
