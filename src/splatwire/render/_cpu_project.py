"""Compiled projection of Gaussians to the image, and its gradient. The plain twin is `splatwire.model.projection`.

No fast-math here: comparisons must reject what is not a number.
"""

import math
from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

SPLAT = 16
"""Columns of a splat: x, y, three exponents, log2 of opacity, three colours, depth, its tiles, two that nobody reads.

A splat is one cache line: those of a tile lie far apart, and fetching them is much of the work. The exponents are the
inverse covariance times -log2(e)/2 (diagonal) and -log2(e) (off-diagonal), so that a pixel's falloff is
2 ** ((A dx + B dy) dx + C dy dy).
"""
DEPTH, TILES = 9, 10
LOG2E = 1.4426950408889634
_MIN_ALPHA = 1.0 / 255.0
_MIN_LEVEL = math.log2(_MIN_ALPHA)


@njit(inline="always")
@no_type_check
def _axes(qw, qx, qy, qz):
    """Rows of the rotation matrix of a unit quaternion."""
    return (
        1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy),
        2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
        2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy),
    )  # fmt: skip


@njit(inline="always")
@no_type_check
def _clamped(value, focal, center, size, margin):
    """Tangent of the viewing angle, kept near the image (1.3 times the half field of view when centred)."""
    extra = margin * size / (2 * focal)
    return min(max(value, -center / focal - extra), (size - center) / focal + extra)


@njit(nogil=True, error_model="numpy")
@no_type_check
def project_splats(means, quats, scales, opacities, colors, pose, intrinsics, width, height, constants, splats, tiles):
    """Fills one row of `splats` and `tiles` (left, top, right, bottom) per Gaussian; no tiles where it is not drawn.

    A Gaussian is listed in the tiles of 3DGS's square of three standard deviations, less those that its ellipse of
    alpha >= 1/255 cannot reach (which changes no pixel). `constants`: near depth, dilation, frustum margin, tile side.
    """
    fx, fy, cx, cy = intrinsics
    near, dilation, margin, side = constants
    per_pixel = 1 / side  # exact: the side is a power of two
    grid_x, grid_y = math.ceil(width / side), math.ceil(height / side)
    for g in range(means.shape[0]):
        tiles[g, :] = 0
        m0, m1, m2 = np.float64(means[g, 0]), np.float64(means[g, 1]), np.float64(means[g, 2])
        z = pose[2, 0] * m0 + pose[2, 1] * m1 + pose[2, 2] * m2 + pose[2, 3]
        opacity = np.float64(opacities[g])
        if not (z > near and opacity >= _MIN_ALPHA):
            continue
        x = (pose[0, 0] * m0 + pose[0, 1] * m1 + pose[0, 2] * m2 + pose[0, 3]) / z
        y = (pose[1, 0] * m0 + pose[1, 1] * m1 + pose[1, 2] * m2 + pose[1, 3]) / z
        xx, xy, yy = _covariance(quats[g], scales[g], pose, fx, fy, z, _clamped(x, fx, cx, width, margin),
                                 _clamped(y, fy, cy, height, margin))  # fmt: skip
        xx, yy = xx + dilation, yy + dilation
        det = xx * yy - xy * xy
        u, v = fx * x + cx - 0.5, fy * y + cy - 0.5
        if not (det > 0 and abs(u) < 1e8 and abs(v) < 1e8 and xx < 1e12 and yy < 1e12):
            continue
        middle = 0.5 * (xx + yy)
        radius = math.ceil(3 * math.sqrt(middle + math.sqrt(max(0.1, middle * middle - det))))
        level = math.log2(opacity)
        reach = 2 / LOG2E * (level - _MIN_LEVEL)
        half_x, half_y = math.sqrt(reach * xx) + 1e-2, math.sqrt(reach * yy) + 1e-2
        left = max(math.floor((u - min(radius, half_x)) * per_pixel), 0)
        top = max(math.floor((v - min(radius, half_y)) * per_pixel), 0)
        right = min(math.floor((u + min(radius + side - 1, half_x + side)) * per_pixel), grid_x)
        bottom = min(math.floor((v + min(radius + side - 1, half_y + side)) * per_pixel), grid_y)
        if right <= left or bottom <= top:
            continue
        tiles[g, 0], tiles[g, 1], tiles[g, 2], tiles[g, 3] = left, top, right, bottom
        splats[g, 0], splats[g, 1] = u, v
        splats[g, 2] = -0.5 * LOG2E * yy / det
        splats[g, 3] = LOG2E * xy / det
        splats[g, 4] = -0.5 * LOG2E * xx / det
        splats[g, 5] = level
        splats[g, 6], splats[g, 7], splats[g, 8] = colors[g, 0], colors[g, 1], colors[g, 2]
        splats[g, DEPTH] = z
        for side_of_box in range(4):
            splats[g, TILES + side_of_box] = tiles[g, side_of_box]


@njit(inline="always")
@no_type_check
def _covariance(quat, scale, pose, fx, fy, z, x, y):
    """Entries xx, xy, yy of the 2D covariance before dilation, at the tangents `x`, `y`."""
    r = _axes(np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3]))
    xx = xy = yy = 0.0
    for k in range(3):
        a = b = 0.0
        for i in range(3):
            a += fx / z * (pose[0, i] - x * pose[2, i]) * r[3 * i + k]
            b += fy / z * (pose[1, i] - y * pose[2, i]) * r[3 * i + k]
        a, b = a * scale[k], b * scale[k]
        xx, xy, yy = xx + a * a, xy + a * b, yy + b * b
    return xx, xy, yy


@njit(nogil=True, error_model="numpy")
@no_type_check
def project_back(
    means, quats, scales, opacities, pose, intrinsics, width, height, constants, splats, tiles, sums,
    d_means, d_quats, d_scales, d_opacities, d_colors, d_means2d,
):  # fmt: skip
    """Turns the nine sums per Gaussian of `_cpu_kernels.draw_tiles_back` into gradients of what was projected."""
    for g in range(means.shape[0]):
        if tiles[g, 2] <= tiles[g, 0]:
            continue
        a, b, c = -2 / LOG2E * splats[g, 2], -1 / LOG2E * splats[g, 3], -2 / LOG2E * splats[g, 4]
        s = sums[g]
        d_opacities[g] = s[0] / opacities[g]
        d_colors[g, 0], d_colors[g, 1], d_colors[g, 2] = s[6], s[7], s[8]
        du, dv = a * s[1] + b * s[2], b * s[1] + c * s[2]
        d_means2d[g, 0], d_means2d[g, 1] = du, dv
        # The inverse covariance Q has gradient G = -S/2, its inverse therefore -Q G Q.
        dxx = 0.5 * (a * a * s[3] + 2 * a * b * s[4] + b * b * s[5])
        dxy = a * b * s[3] + (a * c + b * b) * s[4] + b * c * s[5]
        dyy = 0.5 * (b * b * s[3] + 2 * b * c * s[4] + c * c * s[5])
        _project_back_one(
            means[g], quats[g], scales[g], pose, intrinsics, width, height, constants[2], du, dv, dxx, dxy, dyy,
            d_means[g], d_quats[g], d_scales[g],
        )  # fmt: skip


@njit()
@no_type_check
def _project_back_one(
    mean, quat, scale, pose, intrinsics, width, height, margin, du, dv, dxx, dxy, dyy, d_mean, d_quat, d_scale
):
    """Chain rule from the 2D mean and covariance to the 3D mean, axes and scales."""
    fx, fy, cx, cy = intrinsics
    m0, m1, m2 = np.float64(mean[0]), np.float64(mean[1]), np.float64(mean[2])
    z = pose[2, 0] * m0 + pose[2, 1] * m1 + pose[2, 2] * m2 + pose[2, 3]
    x = (pose[0, 0] * m0 + pose[0, 1] * m1 + pose[0, 2] * m2 + pose[0, 3]) / z
    y = (pose[1, 0] * m0 + pose[1, 1] * m1 + pose[1, 2] * m2 + pose[1, 3]) / z
    clamped_x, clamped_y = _clamped(x, fx, cx, width, margin), _clamped(y, fy, cy, height, margin)
    qw, qx, qy, qz = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    r = _axes(qw, qx, qy, qz)
    row_x, row_y = _row(pose, 0, fx / z, clamped_x), _row(pose, 1, fy / z, clamped_y)
    a0, b0 = _column_back(row_x, row_y, (r[0], r[3], r[6]), scale, 0, dxx, dxy, dyy, d_scale)
    a1, b1 = _column_back(row_x, row_y, (r[1], r[4], r[7]), scale, 1, dxx, dxy, dyy, d_scale)
    a2, b2 = _column_back(row_x, row_y, (r[2], r[5], r[8]), scale, 2, dxx, dxy, dyy, d_scale)
    d_x, d_y = fx * du, fy * dv
    # What the rows of the Jacobian get: they depend on the depth and, where the angle is not clamped, on the angle.
    row_x_0, row_x_1, row_x_2 = _turned(r, a0, a1, a2)
    row_y_0, row_y_1, row_y_2 = _turned(r, b0, b1, b2)
    d_z = -(row_x_0 * row_x[0] + row_x_1 * row_x[1] + row_x_2 * row_x[2]) / z
    d_z -= (row_y_0 * row_y[0] + row_y_1 * row_y[1] + row_y_2 * row_y[2]) / z
    if x == clamped_x:
        d_x -= (row_x_0 * pose[2, 0] + row_x_1 * pose[2, 1] + row_x_2 * pose[2, 2]) * fx / z
    if y == clamped_y:
        d_y -= (row_y_0 * pose[2, 0] + row_y_1 * pose[2, 1] + row_y_2 * pose[2, 2]) * fy / z
    d_z -= (d_x * x + d_y * y) / z
    for i in range(3):
        d_mean[i] = pose[0, i] * d_x / z + pose[1, i] * d_y / z + pose[2, i] * d_z
    d_r = (
        a0 * row_x[0] + b0 * row_y[0], a1 * row_x[0] + b1 * row_y[0], a2 * row_x[0] + b2 * row_y[0],
        a0 * row_x[1] + b0 * row_y[1], a1 * row_x[1] + b1 * row_y[1], a2 * row_x[1] + b2 * row_y[1],
        a0 * row_x[2] + b0 * row_y[2], a1 * row_x[2] + b1 * row_y[2], a2 * row_x[2] + b2 * row_y[2],
    )  # fmt: skip
    _axes_back(qw, qx, qy, qz, d_r, d_quat)


@njit(inline="always")
@no_type_check
def _row(pose, axis, by, slope):
    """A row of the Jacobian of the projection, along the world's axes. No arrays here: they would be allocated."""
    return (
        by * (pose[axis, 0] - slope * pose[2, 0]),
        by * (pose[axis, 1] - slope * pose[2, 1]),
        by * (pose[axis, 2] - slope * pose[2, 2]),
    )


@njit(inline="always")
@no_type_check
def _turned(r, a, b, c):
    """The rotation matrix times a vector."""
    return r[0] * a + r[1] * b + r[2] * c, r[3] * a + r[4] * b + r[5] * c, r[6] * a + r[7] * b + r[8] * c


@njit(inline="always")
@no_type_check
def _column_back(row_x, row_y, axis, scales, k, dxx, dxy, dyy, d_scale):
    """Gradient of one scale, and of its scaled axis along image x and y, times the scale."""
    along_x = row_x[0] * axis[0] + row_x[1] * axis[1] + row_x[2] * axis[2]
    along_y = row_y[0] * axis[0] + row_y[1] * axis[1] + row_y[2] * axis[2]
    scale = np.float64(scales[k])
    d_a, d_b = (2 * dxx * along_x + dxy * along_y) * scale, (2 * dyy * along_y + dxy * along_x) * scale
    d_scale[k] = d_a * along_x + d_b * along_y
    return d_a * scale, d_b * scale


@njit()
@no_type_check
def _axes_back(w, x, y, z, g, out):
    """Gradient of the rotation matrix's entries with respect to the quaternion."""
    out[0] = 2 * (z * (g[3] - g[1]) + y * (g[2] - g[6]) + x * (g[7] - g[5]))
    out[1] = 2 * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5]) - 2 * x * (g[4] + g[8]))
    out[2] = 2 * (x * (g[1] + g[3]) + z * (g[5] + g[7]) + w * (g[2] - g[6]) - 2 * y * (g[0] + g[8]))
    out[3] = 2 * (x * (g[2] + g[6]) + y * (g[5] + g[7]) + w * (g[3] - g[1]) - 2 * z * (g[0] + g[4]))
