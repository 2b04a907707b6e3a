"""Numba kernels that convert decoded integers of Gaussians to floats."""

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import (
    AXIS,
    BITS,
    ELONGATION,
    FLATNESS,
    LUMA,
    OPACITY,
    POSITION,
    PRIMARY,
    SCALE0,
    SPIN,
    SPIN_BITS,
)
from splatwire.ops.compiled import njit

ZERO_EXPONENT = 256
"""Index of `2 ** 0` in `POWERS_OF_TWO`."""
POWERS_OF_TWO = 2.0 ** np.arange(-ZERO_EXPONENT, ZERO_EXPONENT)
"""Powers of two with whole exponents: the exponent e has the index `e + ZERO_EXPONENT`."""
FRACTION = (1 << BITS) - 1


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def convert(
    rows,
    indices,
    corners,
    size_log,
    lattice_bits,
    flatness_table,
    powers,
    to_rgb,
    grey,
    means,
    quats,
    scales,
    opacities,
    sh,
    scratch,
):
    """Converts decoded integers of Gaussians to floats, and writes them to the scene.

    Args:
        rows: Decoded integers, int64 (n, columns).
        indices: For each of the n Gaussians, its index in the output arrays, int64 (n).
        corners: Lower corners of the bounding boxes of the Gaussians' blocks, in lattice spacings, int64 (n, 3).
        size_log: log2 of the scene size in world units.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        flatness_table: Table for decoding the ratio of two scales, from `flatness_table`.
        powers: Table of powers of two, from `exponentials`.
        to_rgb: Factors from Y, Co and Cg (rows) to red, green and blue (columns), divided by the value of the spherical
            harmonic of degree 0, float64 (3, 3).
        grey: Y Co Cg of the colour of a Gaussian whose harmonics are 0, float64 (3).
        means: Output for the N Gaussians of the scene: centres, world units relative to the scene's origin, float32
            (N, 3).
        quats: Output, unit quaternions (w, x, y, z), float32 (N, 4).
        scales: Output, standard deviations, float32 (N, 3).
        opacities: Output, float32 (N).
        sh: Output, spherical harmonics, float32 (N, K + 1, 3); only degree 0 is written.
        scratch: Working array, float64 (9).
    """
    half_spacing = POWERS_OF_TWO[size_log - lattice_bits - 1 + ZERO_EXPONENT]
    for i in range(len(rows)):
        row, index = rows[i], indices[i]
        for a in range(3):
            means[index, a] = np.float64(2 * corners[i, a] + row[POSITION + a]) * half_spacing
        log = row[SCALE0] + (size_log << BITS)
        scales[index, 0] = powers[log & FRACTION] * POWERS_OF_TWO[(log >> BITS) + ZERO_EXPONENT]
        log -= row[ELONGATION]
        scales[index, 1] = powers[log & FRACTION] * POWERS_OF_TWO[(log >> BITS) + ZERO_EXPONENT]
        log -= flatness_table[row[FLATNESS]]
        scales[index, 2] = powers[log & FRACTION] * POWERS_OF_TWO[(log >> BITS) + ZERO_EXPONENT]
        log = row[OPACITY]
        opacities[index] = powers[log & FRACTION] * POWERS_OF_TWO[(log >> BITS) + ZERO_EXPONENT]
        y, co, cg = row[LUMA] * 2.0**-BITS - grey[0], row[LUMA + 1] * 2.0**-BITS, row[LUMA + 2] * 2.0**-BITS
        co, cg = co - grey[1], cg - grey[2]
        for c in range(3):
            sh[index, 0, c] = y * to_rgb[0, c] + co * to_rgb[1, c] + cg * to_rgb[2, c]
        _rotation(row, scratch, quats[index])


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _rotation(row, axes, quat):
    """Computes the quaternion of a Gaussian from its primary axis and the rotation angle about this axis.

    Args:
        row: Decoded integers of the Gaussian, int64 (columns).
        axes: Working array for the three axes, float64 (9).
        quat: Output: unit quaternion (w, x, y, z), float32 (4).
    """
    # The primary axis u was decoded. The second axis v is perpendicular to u, at the decoded angle. The third axis w is
    # their cross product. The quaternion is computed from the largest of its components (Shepperd, 1978).
    ux, uy, uz = np.float64(row[AXIS]), np.float64(row[AXIS + 1]), np.float64(row[AXIS + 2])
    norm = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    if abs(ux) <= abs(uy) and abs(ux) <= abs(uz):
        tx, ty, tz = 1.0 - ux * ux, -ux * uy, -ux * uz
    elif abs(uy) <= abs(uz):
        tx, ty, tz = -uy * ux, 1.0 - uy * uy, -uy * uz
    else:
        tx, ty, tz = -uz * ux, -uz * uy, 1.0 - uz * uz
    norm = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / norm, ty / norm, tz / norm
    angle = row[SPIN] * (np.pi * POWERS_OF_TWO[ZERO_EXPONENT - row[SPIN_BITS]])
    cos, sin = np.cos(angle), np.sin(angle)
    vx = cos * tx + sin * (uy * tz - uz * ty)
    vy = cos * ty + sin * (uz * tx - ux * tz)
    vz = cos * tz + sin * (ux * ty - uy * tx)
    at = 3 * row[PRIMARY]
    axes[at], axes[at + 1], axes[at + 2] = ux, uy, uz
    at = (at + 3) % 9
    axes[at], axes[at + 1], axes[at + 2] = vx, vy, vz
    at = (at + 3) % 9
    axes[at], axes[at + 1], axes[at + 2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    xx, yx, zx, xy, yy, zy, xz, yz, zz = (
        axes[0], axes[1], axes[2], axes[3], axes[4], axes[5], axes[6], axes[7], axes[8]
    )  # fmt: skip
    trace = xx + yy + zz
    w, x, y, z = trace + 1, 2 * xx - trace + 1, 2 * yy - trace + 1, 2 * zz - trace + 1
    if w >= x and w >= y and w >= z:
        x, y, z = zy - yz, xz - zx, yx - xy
    elif x >= y and x >= z:
        w, y, z = zy - yz, xy + yx, xz + zx
    elif y >= z:
        w, x, z = xz - zx, xy + yx, yz + zy
    else:
        w, x, y = yx - xy, xz + zx, yz + zy
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    quat[0], quat[1], quat[2], quat[3] = w / norm, x / norm, y / norm, z / norm


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def convert_harmonics(harmonics, indices, transform, to_rgb, scratch, sh):
    """Converts decoded integers to spherical harmonics, and writes them to the scene.

    Args:
        harmonics: Decoded integers of n Gaussians, int32 (n, 3 K): Y, Co and Cg of the first transformed harmonic, then
            of the second, and so on.
        indices: For each of the n Gaussians, its index in the output, int64 (n).
        transform: Decorrelating transform of the K harmonics, one row per transformed harmonic, as whole numbers in
            float64 (K, K).
        to_rgb: Factors from Y, Co and Cg (rows) to red, green and blue (columns), float64 (3, 3).
        scratch: Working array, float64 (3 K).
        sh: Output for the N Gaussians of the scene, float32 (N, K + 1, 3): red, green and blue of each harmonic; degree
            0 is not written.
    """
    width = harmonics.shape[1]
    for i in range(len(harmonics)):
        empty, index = True, indices[i]
        for k in range(0, width, 3):
            y, co, cg = np.float64(harmonics[i, k]), np.float64(harmonics[i, k + 1]), np.float64(harmonics[i, k + 2])
            if y == 0.0 and co == 0.0 and cg == 0.0:
                continue
            if empty:
                for b in range(width):
                    scratch[b] = 0.0
                empty = False
            for b in range(width // 3):
                factor = transform[k // 3, b]
                scratch[3 * b] += y * factor
                scratch[3 * b + 1] += co * factor
                scratch[3 * b + 2] += cg * factor
        for b in range(0, width, 3):
            for c in range(3):
                sh[index, 1 + b // 3, c] = (
                    0.0
                    if empty
                    else scratch[b] * to_rgb[0, c] + scratch[b + 1] * to_rgb[1, c] + scratch[b + 2] * to_rgb[2, c]
                )
