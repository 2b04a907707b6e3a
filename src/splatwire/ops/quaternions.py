"""Conversion between unit quaternions (w, x, y, z) and rotation matrices."""

from typing import Any

import numpy as np


def rotation_rows(w: Any, x: Any, y: Any, z: Any) -> list[list[Any]]:
    """Converts unit quaternions to rotation matrices, as three rows of three components each.

    Components are numbers, arrays or tensors of one shape.
    """
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """Converts quaternions (N, 4) to rotation matrices (N, 3, 3)."""
    return np.moveaxis(np.array(rotation_rows(*quats.T)), 2, 0)


def quaternions_of(m: np.ndarray) -> np.ndarray:
    """Converts rotation matrices (n, 3, 3) to unit quaternions (w, x, y, z) (Shepperd, 1978)."""
    d = np.diagonal(m, axis1=1, axis2=2)
    squares = np.concatenate([d.sum(axis=1)[:, None], 2 * d - d.sum(axis=1)[:, None]], axis=1) + 1
    x, y, z = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    products = np.stack(
        [
            np.stack([squares[:, 0], x, y, z], axis=1),
            np.stack([x, squares[:, 1], xy, xz], axis=1),
            np.stack([y, xy, squares[:, 2], yz], axis=1),
            np.stack([z, xz, yz, squares[:, 3]], axis=1),
        ],
        axis=1,
    )
    quats = products[np.arange(len(m)), np.argmax(squares, axis=1)]
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)
