"""Morton (Z-order) codes: the bits of x, y and z interleaved, x lowest."""

import numpy as np

_SPREADS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
MAX_AXIS_BITS = 21
"""Maximum bits per coordinate; three axes fill 63 bits."""


def morton_encode(points: np.ndarray) -> np.ndarray:
    """Converts points to Morton codes by interleaving the bits of their coordinates.

    Args:
        points: int64 (N, 3), each in [0, 2**21).

    Returns:
        int64 (N): bit 3 i + a is bit i of axis a.

    Raises:
        ValueError: If a coordinate is negative or too large.
    """
    if len(points) and (points.min() < 0 or points.max() >> MAX_AXIS_BITS):
        raise ValueError(f"coordinates must be in [0, 2**{MAX_AXIS_BITS}) to have a Morton code")
    code = np.zeros(len(points), dtype=np.int64)
    for axis in range(3):
        spread = points[:, axis].astype(np.int64)
        for shift, mask in _SPREADS:
            spread = (spread | (spread << shift)) & mask
        code |= spread << axis
    return code


def morton_decode(codes: np.ndarray) -> np.ndarray:
    """Converts Morton codes back to points.

    Args:
        codes: int64 (N), non-negative.

    Returns:
        int64 (N, 3).
    """
    points = np.empty((len(codes), 3), dtype=np.int64)
    for axis in range(3):
        packed = (codes >> axis) & _SPREADS[-1][1]
        for (shift, _), (_, mask) in zip(reversed(_SPREADS), [*reversed(_SPREADS[:-1]), (0, 0x1FFFFF)], strict=True):
            packed = (packed | (packed >> shift)) & mask
        points[:, axis] = packed
    return points
