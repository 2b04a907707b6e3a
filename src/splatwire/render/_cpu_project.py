"""Compiled projection of Gaussians to the image, and its gradient; the reference is `splatwire.anchors.projection`."""

# No fast-math here: comparisons must reject NaN.

import math
from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

PROJECTED_STRIDE = 16
"""Number of values of a projected Gaussian: x, y, three exponents, log2 of opacity, three colours, depth, the
tile range (4 values), half the height, and an unused one. They fill one cache line, because the Gaussians of a tile are
scattered in memory and fetching them is much of the work. The exponents are the inverse covariance times -log2(e)/2
(diagonal) and -log2(e) (off-diagonal), so that a pixel's falloff is 2 ** ((A dx + B dy) dx + C dy dy)."""
DEPTH, TILES, HALF_HEIGHT = 9, 10, 14
CHUNK = 64
"""Number of Gaussians projected together, in one flat array with a row for each value; vectorisation requires a single
base pointer."""
QUAT, SCALE, LOG_OPACITY, OUT, BOX, DRAWN, NUM_ROWS = (
    3 * CHUNK,
    7 * CHUNK,
    10 * CHUNK,
    11 * CHUNK,
    18 * CHUNK,
    22 * CHUNK,
    23,
)
LOG2E = 1.4426950408889634
_MIN_LOG_OPACITY = math.log2(1.0 / 255.0)


@njit(inline="always")
@no_type_check
def _rotation_matrix(qw, qx, qy, qz):
    """Returns the rotation matrix of a unit quaternion as nine numbers, row by row."""
    return (
        1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy),
        2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
        2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy),
    )  # fmt: skip


@njit(inline="always")
@no_type_check
def _clamped(value, focal, center, size, margin):
    """Clamps the tangent of a viewing angle along one image axis to the field of view plus a margin.

    Args:
        value: The tangent.
        focal: Focal length along the axis, pixels.
        center: Principal point along the axis, pixels.
        size: Image size along the axis, pixels.
        margin: Additional range on each side, as a fraction of half the image; 0.3 in 3DGS.
    """
    extra = margin * size / (2 * focal)
    return min(max(value, -center / focal - extra), (size - center) / focal + extra)


@njit(borrows=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})
@no_type_check
def _project_chunk(work, pose, intrinsics, width, height, constants):
    """Projects `CHUNK` Gaussians to the image.

    Args:
        work: Buffer with the parameters of the Gaussians; receives the results.
        pose: World-to-camera transform.
        intrinsics: Focal lengths and principal point, pixels.
        width: Width of the image, pixels.
        height: Height of the image, pixels.
        constants: Minimum depth, dilation of the projected covariance, frustum margin, side of a tile.
    """
    # The loop has no branches, so that the compiler vectorises it. The buffer contains the input and receives the
    # result. It has `CHUNK` numbers for each quantity; constants such as `QUAT` and `OUT` are the index of the
    # first number of a quantity.
    fx, fy, cx, cy = intrinsics
    near, dilation, margin, side = constants
    grid_x, grid_y, per_pixel = np.ceil(width / side), np.ceil(height / side), 1 / side  # exact: a power of two
    for i in range(CHUNK):
        m0, m1, m2 = work[i], work[CHUNK + i], work[2 * CHUNK + i]
        z = pose[2, 0] * m0 + pose[2, 1] * m1 + pose[2, 2] * m2 + pose[2, 3]
        x = (pose[0, 0] * m0 + pose[0, 1] * m1 + pose[0, 2] * m2 + pose[0, 3]) / z
        y = (pose[1, 0] * m0 + pose[1, 1] * m1 + pose[1, 2] * m2 + pose[1, 3]) / z
        r = _rotation_matrix(
            work[QUAT + i], work[QUAT + CHUNK + i], work[QUAT + 2 * CHUNK + i], work[QUAT + 3 * CHUNK + i]
        )
        row_x = _coordinate_gradient(pose, 0, fx / z, _clamped(x, fx, cx, width, margin))
        row_y = _coordinate_gradient(pose, 1, fy / z, _clamped(y, fy, cy, height, margin))
        a0, b0 = _scaled_axis(row_x, row_y, (r[0], r[3], r[6]), work[SCALE + i])
        a1, b1 = _scaled_axis(row_x, row_y, (r[1], r[4], r[7]), work[SCALE + CHUNK + i])
        a2, b2 = _scaled_axis(row_x, row_y, (r[2], r[5], r[8]), work[SCALE + 2 * CHUNK + i])
        xx, yy = a0 * a0 + a1 * a1 + a2 * a2 + dilation, b0 * b0 + b1 * b1 + b2 * b2 + dilation
        xy = a0 * b0 + a1 * b1 + a2 * b2
        det, middle, u, v = xx * yy - xy * xy, 0.5 * (xx + yy), fx * x + cx - 0.5, fy * y + cy - 0.5
        radius = np.ceil(3 * np.sqrt(middle + np.sqrt(max(0.1, middle * middle - det))))
        # squared distance from the centre, in standard deviations, where alpha is 1/255
        squared_sigmas = 2 / LOG2E * (work[LOG_OPACITY + i] - _MIN_LOG_OPACITY)
        half_x, half_y = np.sqrt(squared_sigmas * xx) + 1e-2, np.sqrt(squared_sigmas * yy) + 1e-2
        left = max(np.floor((u - min(radius, half_x)) * per_pixel), 0.0)
        top = max(np.floor((v - min(radius, half_y)) * per_pixel), 0.0)
        right = min(np.floor((u + min(radius + side - 1, half_x + side)) * per_pixel), grid_x)
        bottom = min(np.floor((v + min(radius + side - 1, half_y + side)) * per_pixel), grid_y)
        is_valid = (z > near) & (det > 0) & (abs(u) < 1e8) & (abs(v) < 1e8) & (xx < 1e12) & (yy < 1e12)
        drawn = is_valid & (work[LOG_OPACITY + i] >= _MIN_LOG_OPACITY) & (right > left) & (bottom > top)
        work[OUT + i], work[OUT + CHUNK + i] = u, v
        work[OUT + 2 * CHUNK + i] = -0.5 * LOG2E * yy / det
        work[OUT + 3 * CHUNK + i] = LOG2E * xy / det
        work[OUT + 4 * CHUNK + i] = -0.5 * LOG2E * xx / det
        work[OUT + 5 * CHUNK + i], work[OUT + 6 * CHUNK + i] = z, half_y
        work[BOX + i], work[BOX + CHUNK + i] = left, top
        work[BOX + 2 * CHUNK + i], work[BOX + 3 * CHUNK + i] = right, bottom
        work[DRAWN + i] = 1.0 if drawn else 0.0


@njit(nogil=True, error_model="numpy")
@no_type_check
def project_splats(
    means, quats, scales, opacities, colors, pose, intrinsics, width, height, constants, projected, tiles
):
    """Projects Gaussians to the image, and finds the tiles that each of them overlaps.

    Args:
        means: Centres, world units, relative to the origin of `pose`.
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations along the axes, world units.
        opacities: Opacities.
        colors: RGB colours.
        pose: World-to-camera transform.
        intrinsics: Focal lengths and principal point, pixels.
        width: Width of the image, pixels.
        height: Height of the image, pixels.
        constants: Minimum depth, dilation of the projected covariance, frustum margin, side of a tile.
        projected: Output: projected Gaussians, one row each.
        tiles: Output: range of tiles of each Gaussian (left, top, right, bottom); empty if it is not drawn.
    """
    # The range of tiles covers the square of three standard deviations, as in 3DGS. Tiles outside the ellipse of
    # alpha >= 1/255 are left out, because the Gaussian is not drawn there.
    work, num = np.zeros(NUM_ROWS * CHUNK), means.shape[0]
    for first in range(0, num, CHUNK):
        count = min(CHUNK, num - first)
        for i in range(count):
            g = first + i
            for k in range(3):
                work[k * CHUNK + i], work[SCALE + k * CHUNK + i] = means[g, k], scales[g, k]
            for k in range(4):
                work[QUAT + k * CHUNK + i] = quats[g, k]
            work[LOG_OPACITY + i] = math.log2(np.float64(opacities[g])) if opacities[g] > 0 else -np.inf
        _project_chunk(work, pose, intrinsics, width, height, constants)
        for i in range(count):
            g, drawn = first + i, work[DRAWN + i] > 0
            for k in range(4):
                tiles[g, k] = np.int32(work[BOX + k * CHUNK + i]) if drawn else np.int32(0)
            if drawn:
                for k in range(5):
                    projected[g, k] = work[OUT + k * CHUNK + i]
                projected[g, 5], projected[g, DEPTH] = work[LOG_OPACITY + i], work[OUT + 5 * CHUNK + i]
                projected[g, HALF_HEIGHT] = work[OUT + 6 * CHUNK + i]
                for k in range(3):
                    projected[g, 6 + k] = colors[g, k]
                for k in range(4):
                    projected[g, TILES + k] = work[BOX + k * CHUNK + i]


@njit(inline="always")
@no_type_check
def _scaled_axis(row_x, row_y, axis, scale):
    """Projects one principal axis of a Gaussian, scaled by its standard deviation, to the image plane.

    Args:
        row_x: First row of the projection's Jacobian.
        row_y: Second row of the projection's Jacobian.
        axis: The principal axis.
        scale: Standard deviation along the axis, world units.
    """
    along_x = row_x[0] * axis[0] + row_x[1] * axis[1] + row_x[2] * axis[2]
    along_y = row_y[0] * axis[0] + row_y[1] * axis[1] + row_y[2] * axis[2]
    return along_x * scale, along_y * scale


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def project_back(
    means, quats, scales, opacities, pose, intrinsics, width, height, constants, projected, tiles, sums,
    d_means, d_quats, d_scales, d_opacities, d_colors, d_means2d,
):  # fmt: skip
    """Back-propagates gradients from projected Gaussians to the parameters of the Gaussians.

    Args:
        means: Centres, world units, relative to the origin of `pose`.
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations along the axes, world units.
        opacities: Opacities.
        pose: World-to-camera transform.
        intrinsics: Focal lengths and principal point, pixels.
        width: Width of the image, pixels.
        height: Height of the image, pixels.
        constants: Minimum depth, dilation of the projected covariance, frustum margin, side of a tile.
        projected: Projected Gaussians.
        tiles: Range of tiles of each Gaussian.
        sums: Gradient of each projected Gaussian, from `add_rows`.
        d_means: Output: gradient with respect to `means`.
        d_quats: Output: gradient with respect to `quats`.
        d_scales: Output: gradient with respect to `scales`.
        d_opacities: Output: gradient with respect to `opacities`.
        d_colors: Output: gradient with respect to the colours.
        d_means2d: Output: gradient with respect to the projected means.
    """
    # `sums` are the gradient sums of each projected Gaussian, from `draw_tiles_back` and `add_rows`. The arguments
    # up to `tiles` are those of `project_splats`.
    for g in range(means.shape[0]):
        if tiles[g, 2] <= tiles[g, 0]:
            continue
        s, magnitude = sums[g], np.float32(0)
        for k in range(s.shape[0]):
            magnitude += abs(s[k])
        if magnitude == 0:  # most Gaussians are hidden: all gradients stay zero
            continue
        a, b, c = -2 / LOG2E * projected[g, 2], -1 / LOG2E * projected[g, 3], -2 / LOG2E * projected[g, 4]
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


@njit(borrows=True)
@no_type_check
def _project_back_one(
    mean, quat, scale, pose, intrinsics, width, height, margin, du, dv, dxx, dxy, dyy, d_mean, d_quat, d_scale
):
    """Applies the chain rule to one Gaussian: from the projected mean and covariance to mean, quaternion and scales.

    Args:
        mean: Centre, world units, relative to the origin of `pose`.
        quat: Unit quaternion, (w, x, y, z).
        scale: Standard deviations, world units.
        pose: World-to-camera transform.
        intrinsics: Focal lengths and principal point, pixels.
        width: Width of the image, pixels.
        height: Height of the image, pixels.
        margin: Frustum margin, as a fraction of half the image.
        du: Gradient with respect to the first image coordinate of the projected mean.
        dv: Gradient with respect to the second image coordinate.
        dxx: Gradient with respect to entry xx of the projected covariance.
        dxy: Gradient with respect to entry xy.
        dyy: Gradient with respect to entry yy.
        d_mean: Output: gradient with respect to the centre.
        d_quat: Output: gradient with respect to the quaternion.
        d_scale: Output: gradient with respect to the standard deviations.
    """
    fx, fy, cx, cy = intrinsics
    m0, m1, m2 = np.float64(mean[0]), np.float64(mean[1]), np.float64(mean[2])
    z = pose[2, 0] * m0 + pose[2, 1] * m1 + pose[2, 2] * m2 + pose[2, 3]
    x = (pose[0, 0] * m0 + pose[0, 1] * m1 + pose[0, 2] * m2 + pose[0, 3]) / z
    y = (pose[1, 0] * m0 + pose[1, 1] * m1 + pose[1, 2] * m2 + pose[1, 3]) / z
    clamped_x, clamped_y = _clamped(x, fx, cx, width, margin), _clamped(y, fy, cy, height, margin)
    qw, qx, qy, qz = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    r = _rotation_matrix(qw, qx, qy, qz)
    row_x, row_y = _coordinate_gradient(pose, 0, fx / z, clamped_x), _coordinate_gradient(pose, 1, fy / z, clamped_y)
    a0, b0 = _column_back(row_x, row_y, (r[0], r[3], r[6]), scale, 0, dxx, dxy, dyy, d_scale)
    a1, b1 = _column_back(row_x, row_y, (r[1], r[4], r[7]), scale, 1, dxx, dxy, dyy, d_scale)
    a2, b2 = _column_back(row_x, row_y, (r[2], r[5], r[8]), scale, 2, dxx, dxy, dyy, d_scale)
    d_x, d_y = fx * du, fy * dv
    # Gradient through the Jacobian: it depends on the depth and, unless clamped, on the angle.
    row_x_0, row_x_1, row_x_2 = _rotated(r, a0, a1, a2)
    row_y_0, row_y_1, row_y_2 = _rotated(r, b0, b1, b2)
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
    _rotation_matrix_back(qw, qx, qy, qz, d_r, d_quat)


@njit(inline="always")
@no_type_check
def _coordinate_gradient(pose, axis, scale, slope):
    """Returns the gradient of one image coordinate of a point with respect to the point's world coordinates.

    Args:
        pose: World-to-camera transform of the view.
        axis: Image axis, 0 or 1.
        scale: Focal length divided by the depth of the point.
        slope: x / z of the point for axis 0, y / z for axis 1, in camera coordinates.
    """
    return (
        scale * (pose[axis, 0] - slope * pose[2, 0]),
        scale * (pose[axis, 1] - slope * pose[2, 1]),
        scale * (pose[axis, 2] - slope * pose[2, 2]),
    )


@njit(inline="always")
@no_type_check
def _rotated(r, a, b, c):
    """Multiplies the rotation matrix `r` by the vector (`a`, `b`, `c`)."""
    return r[0] * a + r[1] * b + r[2] * c, r[3] * a + r[4] * b + r[5] * c, r[6] * a + r[7] * b + r[8] * c


@njit(inline="always")
@no_type_check
def _column_back(row_x, row_y, axis, scales, k, dxx, dxy, dyy, d_scale):
    """Returns the gradient with respect to one principal axis of a Gaussian.

    Args:
        row_x: First row of the projection's Jacobian.
        row_y: Second row of the projection's Jacobian.
        axis: The principal axis.
        scales: Standard deviations along the axes.
        k: Index of the axis.
        dxx: Gradient with respect to entry xx of the projected covariance.
        dxy: Gradient with respect to entry xy.
        dyy: Gradient with respect to entry yy.
        d_scale: Output: gradient with respect to the standard deviation; entry `k` is written.
    """
    along_x, along_y = _scaled_axis(row_x, row_y, axis, 1.0)
    scale = np.float64(scales[k])
    d_a, d_b = (2 * dxx * along_x + dxy * along_y) * scale, (2 * dyy * along_y + dxy * along_x) * scale
    d_scale[k] = d_a * along_x + d_b * along_y
    return d_a * scale, d_b * scale


@njit()
@no_type_check
def _rotation_matrix_back(w, x, y, z, g, out):
    """Converts the gradient with respect to a rotation matrix to the gradient with respect to its quaternion.

    Args:
        w: Scalar part of the quaternion.
        x: First component of its vector part.
        y: Second component of its vector part.
        z: Third component of its vector part.
        g: Nine gradients of the matrix, row by row.
        out: Output: four gradients of the quaternion.
    """
    out[0] = 2 * (z * (g[3] - g[1]) + y * (g[2] - g[6]) + x * (g[7] - g[5]))
    out[1] = 2 * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5]) - 2 * x * (g[4] + g[8]))
    out[2] = 2 * (x * (g[1] + g[3]) + z * (g[5] + g[7]) + w * (g[2] - g[6]) - 2 * y * (g[0] + g[8]))
    out[3] = 2 * (x * (g[2] + g[6]) + y * (g[5] + g[7]) + w * (g[3] - g[1]) - 2 * z * (g[0] + g[4]))
