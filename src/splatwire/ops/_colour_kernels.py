"""Numba kernel of the colours that a camera sees: spherical harmonics evaluated in the directions of view.

`Splats.seen_from` has the plain version of the same arithmetic, in the same order, with equal results.
"""

import math
from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.spherical_harmonics import DC

# float32 constants, because products with Python numbers would be computed in float64.
_HALF, _MIN_DISTANCE, _ZERO = np.float32(0.5), np.float32(1e-12), np.float32(0)
_TWO, _THREE, _FOUR = np.float32(2), np.float32(3), np.float32(4)
_DC, _FIRST = np.float32(DC), np.float32(math.sqrt(3 / (4 * math.pi)))
_CROSS, _POLAR = np.float32(math.sqrt(15 / (4 * math.pi))), np.float32(math.sqrt(5 / (16 * math.pi)))
_HALF_CROSS, _OUTER = np.float32(math.sqrt(15 / (4 * math.pi)) / 2), np.float32(math.sqrt(35 / (32 * math.pi)))
_MIDDLE, _MIXED = np.float32(math.sqrt(21 / (32 * math.pi))), np.float32(math.sqrt(105 / (4 * math.pi)))
_HALF_MIXED, _POLAR3 = np.float32(math.sqrt(105 / (4 * math.pi)) / 2), np.float32(math.sqrt(7 / (16 * math.pi)))


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def view_colours(means, sh, center, basis, colors):
    """Computes the colours of Gaussians seen by a camera.

    Args:
        means: Positions, float32 (n, 3).
        sh: Spherical harmonics of degree 0 to 3, float32 (n, D, 3).
        center: Position of the camera, float32 (3).
        basis: Working array, float32 (16).
        colors: Output: 0.5 plus the sum of the harmonics, at least 0, float32 (n, 3).
    """
    functions = sh.shape[1]
    for i in range(len(means)):
        x, y, z = means[i, 0] - center[0], means[i, 1] - center[1], means[i, 2] - center[2]
        distance = np.float32(np.sqrt(x * x + y * y + z * z))
        distance = distance if distance != distance else max(distance, _MIN_DISTANCE)
        x, y, z = x / distance, y / distance, z / distance
        basis[0] = x * _ZERO + _DC
        if functions > 1:
            basis[1], basis[2], basis[3] = -_FIRST * y, _FIRST * z, -_FIRST * x
        if functions > 4:
            basis[4], basis[5] = _CROSS * x * y, -_CROSS * y * z
            basis[6] = _POLAR * (_TWO * z * z - x * x - y * y)
            basis[7], basis[8] = -_CROSS * x * z, _HALF_CROSS * (x * x - y * y)
        if functions > 9:
            basis[9] = -_OUTER * y * (_THREE * x * x - y * y)
            basis[10] = _MIXED * x * y * z
            basis[11] = -_MIDDLE * y * (_FOUR * z * z - x * x - y * y)
            basis[12] = _POLAR3 * z * (_TWO * z * z - _THREE * x * x - _THREE * y * y)
            basis[13] = -_MIDDLE * x * (_FOUR * z * z - x * x - y * y)
            basis[14] = _HALF_MIXED * z * (x * x - y * y)
            basis[15] = -_OUTER * x * (x * x - _THREE * y * y)
        red = green = blue = _ZERO
        for k in range(functions):
            value = basis[k]
            red += value * sh[i, k, 0]
            green += value * sh[i, k, 1]
            blue += value * sh[i, k, 2]
        red, green, blue = red + _HALF, green + _HALF, blue + _HALF
        # Comparisons instead of `max`, which keep values that are not numbers as numpy does.
        colors[i, 0] = _ZERO if red < _ZERO else red
        colors[i, 1] = _ZERO if green < _ZERO else green
        colors[i, 2] = _ZERO if blue < _ZERO else blue
