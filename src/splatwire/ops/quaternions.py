"""Unit quaternions (w, x, y, z)."""

from typing import TypeVar

import numpy as np
from torch import Tensor

Number = TypeVar("Number", float, np.ndarray, Tensor)


def rotation_rows(w: Number, x: Number, y: Number, z: Number) -> list[list[Number]]:
    """The rotation matrix of quaternions, row by row: of single numbers, or of as many as arrays hold."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4)."""
    return np.moveaxis(np.array(rotation_rows(*quats.T)), 2, 0)
