"""Numba kernels that convert Gaussians to the fixed-point input of the encoder, and find the order of packets.

The functions of numpy that these kernels replace are in `tests/reference/gaussian_sources.py`.
"""

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import BITS, MAX_COLOUR, MAX_LOG, MAX_OPACITY, MIN_OPACITY
from splatwire.ops.compiled import njit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _fixed(value, low, high):
    """Rounds a number to fixed point with `BITS` fractional bits, within limits."""
    return np.int64(min(max(np.rint(value * (1 << BITS)), low), high))


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _largest_first(scales):
    """Returns the indices of three scales in decreasing order; equal scales keep their order."""
    a, b, c = 0, 1, 2
    if scales[b] > scales[a]:
        a, b = b, a
    if scales[c] > scales[b]:
        b, c = c, b
        if scales[b] > scales[a]:
            a, b = b, a
    return a, b, c


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _write_logs(opacity, scales, size_log, row):
    """Writes base-2 logarithms of the opacity and of the scales, largest first, in fixed point.

    Args:
        opacity: Opacity of the Gaussian.
        scales: Its standard deviations, float32 (3).
        size_log: log2 of the scene's size in world units; scales are relative to this size.
        row: Output, int64 (4).
    """
    low, high = min(scales[0], scales[1]), max(scales[0], scales[1])
    middle = max(low, min(high, scales[2]))
    row[0] = _fixed(np.log2(np.float64(opacity)), MIN_OPACITY, MAX_OPACITY)
    row[1] = _fixed(np.log2(np.float64(max(high, scales[2]))) - size_log, -MAX_LOG, MAX_LOG)
    row[2] = _fixed(np.log2(np.float64(middle)) - size_log, -MAX_LOG, MAX_LOG)
    row[3] = _fixed(np.log2(np.float64(min(low, scales[2]))) - size_log, -MAX_LOG, MAX_LOG)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_logs(opacities, scales, size_log, logs):
    """Writes base-2 logarithms of the opacities and scales of n Gaussians in fixed point.

    Args:
        opacities: float32 (n).
        scales: Standard deviations, float32 (n, 3).
        size_log: log2 of the scene's size in world units; scales are relative to this size.
        logs: Output: opacity and scales, largest first, int64 (n, 4).
    """
    for i in range(len(logs)):
        _write_logs(opacities[i], scales[i], size_log, logs[i])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_colours(base, matrix, grey, colours):
    """Converts base colours of n Gaussians to Y Co Cg in fixed point.

    Args:
        base: Spherical harmonics of degree 0, float32 (n, 3).
        matrix: Transform from RGB to Y Co Cg, times the value of the harmonic of degree 0, float64 (3, 3).
        grey: Y Co Cg of a Gaussian whose harmonics are 0, float64 (3).
        colours: Output, int64 (n, 3).
    """
    for i in range(len(base)):
        r, g, b = np.float64(base[i, 0]), np.float64(base[i, 1]), np.float64(base[i, 2])
        for c in range(3):
            value = grey[c] + (r * matrix[c, 0] + g * matrix[c, 1] + b * matrix[c, 2])
            colours[i, c] = _fixed(value, -MAX_COLOUR, MAX_COLOUR)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_axes(scales, quats, axes):
    """Writes the principal axes of n Gaussians as columns, in the order of decreasing scale.

    Args:
        scales: Standard deviations, float32 (n, 3).
        quats: Quaternions (w, x, y, z) of any length, float32 (n, 4).
        axes: Output, float64 (n, 3, 3).
    """
    for i in range(len(axes)):
        w, x, y, z = np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3])
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        one = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        two = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        three = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        first, second, _ = _largest_first(scales[i])
        for a in range(3):
            columns = one[a], two[a], three[a]
            axes[i, a, 0], axes[i, a, 1] = columns[first], columns[second]
            axes[i, a, 2] = columns[3 - first - second]


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_places(means, factor, places):
    """Converts positions to integer coordinates on a cubic lattice, rounded down.

    Args:
        means: Positions, float32 (n, 3).
        factor: Reciprocal of the spacing of the lattice, a power of two.
        places: Output, int64 (n, 3).

    Returns:
        Largest magnitude of a coordinate.
    """
    most = 0.0
    for i in range(len(means)):
        for a in range(3):
            value = np.floor(np.float64(means[i, a]) * factor)
            most = max(most, abs(value))
            places[i, a] = np.int64(value)
    return most


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_codes(places, shift, codes):
    """Computes Morton codes of positions after dropping the lowest bits of each coordinate.

    Args:
        places: Positions, int64 (n, 3), not negative.
        shift: Number of dropped bits of a coordinate. At most `MAX_CELL_BITS` bits remain.
        codes: Output, int64 (n).

    Returns:
        Bitwise or of all coordinates after the low bits were dropped. It is negative if any coordinate is negative.
    """
    used = np.int64(0)
    for i in range(len(codes)):
        code = np.int64(0)
        for a in range(3):
            spread = places[i, a] >> shift
            used |= spread
            spread = (spread | (spread << 32)) & 0x1F00000000FFFF
            spread = (spread | (spread << 16)) & 0x1F0000FF0000FF
            spread = (spread | (spread << 8)) & 0x100F00F00F00F00F
            spread = (spread | (spread << 4)) & 0x10C30C30C30C30C3
            code |= ((spread | (spread << 2)) & 0x1249249249249249) << a
        codes[i] = code
    return used


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def snap_to_cells(means, shifts, factor, half_unit):
    """Moves each position to the centre of its grid cell. Every position has a cell size of its own.

    Args:
        means: Positions, float32 (n, 3), changed in place.
        shifts: log2 of the side of each position's cell, in lattice spacings, int64 (n).
        factor: Reciprocal of the spacing of the lattice, a power of two.
        half_unit: Half the spacing of the lattice.

    Returns:
        Largest magnitude of a lattice coordinate.
    """
    most = 0.0
    for i in range(len(means)):
        for a in range(3):
            # Twice: the centre of a cell near float32 precision is rounded, possibly into a neighbouring cell.
            for _ in range(2):
                value = np.floor(np.float64(means[i, a]) * factor)
                most = max(most, abs(value))
                means[i, a] = np.float64((2 * (np.int64(value) >> shifts[i]) + 1) << shifts[i]) * half_unit
    return most
