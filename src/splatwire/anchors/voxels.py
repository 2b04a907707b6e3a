"""Anchor positions as integer multiples of the voxel size."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy

MAX_VOXEL_INDEX = (1 << 21) - 1
"""Largest voxel index for which float32 positions still distinguish neighbouring voxels, with a margin."""


def voxel_indices(positions: Float[Any, "N 3"], voxel_size: float) -> Int64[np.ndarray, "N 3"]:
    """Returns positions as integer multiples of the voxel size.

    Args:
        positions: World units, relative to the scene's origin.
        voxel_size: World units per voxel.

    Raises:
        InvalidValueError: If the voxel size is not positive and finite, or a position is not a multiple of it.
    """
    check_voxel_size(voxel_size)
    with np.errstate(over="ignore"):  # checked in the next line
        exact = to_numpy(positions).astype(np.float64) / voxel_size
    if not bool(np.isfinite(exact).all()):
        raise InvalidValueError("anchor positions must be finite")
    indices = np.rint(exact)
    # Two roundings to float32 (of the voxel size and of the product) change a position by up to 2**-23 of itself. The
    # tolerance is 0 at 0: otherwise a far too large voxel size would put a whole scene into one voxel.
    off = np.abs(exact - indices) > np.abs(indices) * 2.0**-22
    wrong = off.any(axis=1) | (np.abs(indices) > MAX_VOXEL_INDEX).any(axis=1)
    if bool(wrong.any()):
        first = int(wrong.argmax())
        raise InvalidValueError(
            f"{int(wrong.sum())} of {len(positions)} anchor positions are not whole multiples (up to "
            f"{MAX_VOXEL_INDEX}) of the voxel size {voxel_size}; the first is anchor {first} at "
            f"{positions[first].tolist()}"
        )
    return indices.astype(np.int64)


def voxel_positions(indices: Int64[Any, "N 3"], voxel_size: float) -> Float[np.ndarray, "N 3"]:
    """Returns the positions of voxels, world units relative to the scene's origin; identical on every machine."""
    return (to_numpy(indices).astype(np.float64) * voxel_size).astype(np.float32)


def check_voxel_size(voxel_size: float) -> None:
    """Checks that a voxel size is valid.

    Raises:
        InvalidValueError: If the voxel size is not positive and finite.
    """
    if not (math.isfinite(voxel_size) and voxel_size > 0):
        raise InvalidValueError(f"the voxel size must be positive and finite, not {voxel_size}")
