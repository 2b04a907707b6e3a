"""Smallest-three coding of rotations in SOG and compressed PLY.

A unit quaternion is stored as the index of its largest component and the other three components.
"""

import numpy as np

_PLACES = np.array([[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]])
"""For each index of the largest component: where w, x, y and z are found in the array of the three other components
followed by the largest."""
_OTHERS = np.stack([np.delete(np.arange(4), axis) for axis in range(4)])


def smallest_three(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Splits unit quaternions into the index of the largest component and the other three components.

    Args:
        quats: Unit quaternions (w, x, y, z), (N, 4).

    Returns:
        Index of the largest component, int64 (N), and the other three components, (N, 3), scaled so that -sqrt(1/2)
        becomes 0 and sqrt(1/2) becomes 1.
    """
    largest = np.abs(quats).argmax(axis=1)
    signed = quats * np.where(quats[np.arange(len(quats)), largest] < 0, -1, 1)[:, None]
    return largest, np.take_along_axis(signed, _OTHERS[largest], axis=1) * 2**-0.5 + 0.5


def from_smallest_three(largest: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Reconstructs quaternions (w, x, y, z), float32 (N, 4), from their three smallest components.

    Args:
        largest: Index of the largest component, int (N); negative values are invalid and give NaN.
        components: The three smallest components, float32 (N, 3), mapped from [-sqrt(1/2), sqrt(1/2)] to [0, 1].
    """
    others = (components - np.float32(0.5)) * np.float32(2**0.5)
    rest = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1, keepdims=True)))
    quats = np.take_along_axis(np.concatenate([others, rest], axis=1), _PLACES[np.maximum(largest, 0)], axis=1)
    return np.where(largest[:, None] < 0, np.float32(np.nan), quats)
