"""Training of the binary hash grid (as in HAC++).

The context model reads the signs of the trained values; rendering does not use the grid. Gradients are computed as if
the values were used directly (straight-through estimator).
"""

# Table rows and interpolation weights depend only on the positions, so they are computed once per set of anchors.

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int32, Int64
from torch import Tensor

from splatwire.neural.model.hash_grid import corner_rows
from splatwire.neural.training import _grid_kernels as kernels
from splatwire.types.anchor_config import PLANES, HashGridConfig

INITIAL_VALUE = 1e-4
"""Initial values of the tables are uniformly distributed in [-INITIAL_VALUE, INITIAL_VALUE]."""


@dataclass(frozen=True, eq=False)
class GridCorners:
    """Table rows and weights from which the hash grid is interpolated at N positions.

    Row indices refer to the concatenation of all tables: 3D table (volume), then planes xy, xz, yz.

    Attributes:
        volume_rows: Table rows of the 8 corners on each 3D level.
        volume_weights: Interpolation weights of these 8 corners.
        plane_rows: Table rows of the 4 corners on each level of each plane.
        plane_weights: Interpolation weights of these 4 corners.
    """

    volume_rows: Int32[Tensor, "L3 N 8"]
    volume_weights: Float32[Tensor, "L3 N 8"]
    plane_rows: Int32[Tensor, "L2 N 4"]
    plane_weights: Float32[Tensor, "L2 N 4"]


@torch.no_grad()
def find_corners(unit: Float[Tensor, "N 3"], config: HashGridConfig) -> GridCorners:
    """Computes the table rows and weights for interpolating the hash grid at given positions.

    Positions are relative to the grid's bounding box, [0, 1] per axis inside the box.
    """
    volume, planes = [], []
    start = 0
    for resolution, rows in zip(config.resolutions_3d, config.rows(3), strict=True):
        volume.append(_level(unit, resolution, rows, start))
        start += rows
    for axes in PLANES:
        for resolution, rows in zip(config.resolutions_2d, config.rows(2), strict=True):
            planes.append(_level(unit[:, list(axes)], resolution, rows, start))
            start += rows
    stacked = [torch.stack(parts) for levels in (volume, planes) for parts in zip(*levels, strict=True)]
    return GridCorners(*stacked)


def _level(unit: Tensor, resolution: int, num_rows: int, start: int) -> tuple[Tensor, Tensor]:
    rows, weights = corner_rows(unit, resolution, num_rows)
    return (rows + start).to(torch.int32), weights.to(torch.float32)


def interpolate_signs(
    volume: Float[Tensor, "rows3 D"],
    planes: Float[Tensor, "3 rows2 D"],
    corners: GridCorners,
    index: Int64[Tensor, "M"],
) -> Float[Tensor, "M H"]:
    """Interpolates the signs of the trained tables at positions; compiled, on the CPU.

    Gradients are computed as if the table entries were used instead of their signs (straight-through estimator).

    Args:
        volume: The trained 3D table, all levels.
        planes: The trained tables of the planes xy, xz and yz.
        corners: Table rows and interpolation weights of all positions.
        index: Indices of the positions at which to interpolate.
    """
    tables = torch.cat([volume, planes.flatten(0, 1)])
    features: Tensor = _InterpolateSigns.apply(tables, corners, index)
    return features


def straight_through_sign(values: Tensor) -> Tensor:
    """Returns the signs of values (+1 for zero), with gradient 1 for values within [-1, 1] and 0 outside."""
    clipped = values.clamp(-1, 1)
    return clipped + (hard_sign(values) - clipped).detach()


def hard_sign(values: Tensor) -> Tensor:
    """Returns the signs of values: -1 or +1, +1 for zero."""
    return torch.where(values >= 0, 1.0, -1.0).to(values)


def sign_bits(volume: Float[Tensor, "rows3 D"], planes: Float[Tensor, "3 rows2 D"]) -> Float[Tensor, ""]:
    """Estimates the bits of all signs of the hash grid in the stream.

    Gradients are computed as if the table entries were used instead of their signs (straight-through estimator).

    Args:
        volume: The trained 3D table, whose signs are coded.
        planes: The trained tables of the planes xy, xz and yz.
    """
    # This is the entropy, given the share of +1 among all signs.
    count = volume.numel() + planes.numel()
    signs = (straight_through_sign(volume).sum() + straight_through_sign(planes).sum()) / count
    share = ((1 + signs) / 2).clamp(1e-6, 1 - 1e-6)
    return -count * (share * torch.log2(share) + (1 - share) * torch.log2(1 - share)) + 32


class _InterpolateSigns(torch.autograd.Function):
    """Autograd function that interpolates the hash grid of signs with compiled kernels."""

    # Gradients are summed in a fixed order, so results are reproducible.

    @staticmethod
    def forward(ctx: Any, tables: Tensor, corners: GridCorners, index: Tensor) -> Tensor:
        values, chosen = tables.detach().numpy(), index.numpy()
        levels = len(corners.volume_rows) + len(corners.plane_rows)
        out = np.empty((len(chosen), levels * values.shape[1]), np.float32)
        signs = np.empty_like(values)
        kernels.signs(values.reshape(-1), signs.reshape(-1))
        kernels.interpolate(signs, *_arrays(corners), chosen, out)
        ctx.corners, ctx.index = corners, index
        ctx.save_for_backward(tables)
        return torch.from_numpy(out)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        (tables,) = ctx.saved_tensors
        gradient = np.zeros(tuple(tables.shape), np.float32)
        kernels.scatter(upstream[0].contiguous().numpy(), *_arrays(ctx.corners), ctx.index.numpy(), gradient)
        kernels.clip_gradient(tables.detach().numpy().reshape(-1), gradient.reshape(-1))
        return torch.from_numpy(gradient), None, None


def _arrays(corners: GridCorners) -> tuple[np.ndarray, ...]:
    return tuple(
        t.numpy() for t in (corners.volume_rows, corners.volume_weights, corners.plane_rows, corners.plane_weights)
    )
