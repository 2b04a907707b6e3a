"""Compiled kernels of the photometric loss."""

# The loops over a row are separate functions so that the compiler vectorises them. The compiler option fast-math is
# off, so that trainings with the same seed give equal results.

from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_HALF = 5
_PAD = 3 * _HALF


@njit(inline="never")
@no_type_check
def _axpy(out, source, start, factor):
    for i in range(out.shape[0]):
        out[i] += factor * source[i + start]


@njit(parallel=True)
@no_type_check
def blur(planes, taps, out):
    """Blurs P images (P, H, 3 W) along both axes with the window `taps`; values beyond the border are zero."""
    num_planes, height, width = planes.shape
    for job in prange(num_planes * height):
        plane, row = job // height, job % height
        column = np.zeros(width + 2 * _PAD, np.float32)
        inner = column[_PAD : _PAD + width]
        for t in range(taps.shape[0]):
            source = row + t - _HALF
            if 0 <= source < height:
                _axpy(inner, planes[plane, source], 0, taps[t])
        target = out[plane, row]
        target[:] = np.float32(0)
        for t in range(taps.shape[0]):
            _axpy(target, column, 3 * t, taps[t])


@njit(parallel=True)
@no_type_check
def products(x, y, out):
    """Computes x, x * x and x * y for SSIM, written to `out` (3, n)."""
    for i in prange(x.shape[0]):
        out[0, i], out[1, i], out[2, i] = x[i], x[i] * x[i], x[i] * y[i]


@njit(inline="never", error_model="numpy")
@no_type_check
def _similarity_row(mean_x, xx, xy, mean_y, yy, x, y, c1, c2, ssim):
    """Computes SSIM for one row of pixels, and its gradient with respect to the blurred moments of the picture.

    Args:
        mean_x: Blurred x; overwritten by the gradient with respect to blurred x.
        xx: Blurred x * x; overwritten by the gradient with respect to blurred x * x.
        xy: Blurred x * y; overwritten by the gradient with respect to blurred x * y.
        mean_y: Blurred y.
        yy: Blurred y * y.
        x: Row of the picture.
        y: Row of the photo.
        c1: First constant of SSIM.
        c2: Second constant of SSIM.
        ssim: Output: SSIM at each pixel of the row.
    """
    one, two = np.float32(1), np.float32(2)
    for i in range(x.shape[0]):
        mx, my = mean_x[i], mean_y[i]
        a1, b1 = two * mx * my + c1, mx * mx + my * my + c1
        a2 = two * (xy[i] - mx * my) + c2
        b2 = (xx[i] - mx * mx) + (yy[i] - my * my) + c2
        i1, i2 = one / b1, one / b2
        value = a1 * a2 * i1 * i2
        d_xx = -value * i2
        d_xy = two * a1 * i1 * i2
        mean_x[i] = two * (my * a2 * i1 * i2 - value * mx * i1) - my * d_xy - two * mx * d_xx
        xx[i] = d_xx
        xy[i] = d_xy
        ssim[i] = value


@njit(parallel=True)
@no_type_check
def similarity(moments, blurred, x, y, c1, c2, sums):
    """Computes the sum of SSIM, and the sum of absolute errors, over each image row.

    Also computes the gradient of SSIM. Images have one row of RGB values per row of pixels, (H, 3 W).

    Args:
        moments: Blurred x, x * x and x * y, (3, H, 3 W); overwritten by the gradient of SSIM with respect to these
            moments.
        blurred: Blurred y and y * y, (2, H, 3 W).
        x: The picture, (H, 3 W).
        y: The photo, (H, 3 W).
        c1: First constant of SSIM.
        c2: Second constant of SSIM.
        sums: Output, both sums of each row, (H, 2).
    """
    first, second = np.float32(c1), np.float32(c2)
    for r in prange(x.shape[0]):
        ssim = np.empty(x.shape[1], np.float32)
        _similarity_row(
            moments[0, r], moments[1, r], moments[2, r], blurred[0, r], blurred[1, r], x[r], y[r], first, second, ssim
        )
        total = error = 0.0
        for i in range(x.shape[1]):
            total += ssim[i]
            error += abs(x[r, i] - y[r, i])
        sums[r, 0], sums[r, 1] = total, error


@njit(parallel=True)
@no_type_check
def combine(gradients, x, y, dssim, out):
    """Computes the gradient of the photometric loss with respect to the picture, and writes it to `out`.

    Images are flat lists of n values.

    Args:
        gradients: Blurred gradients of SSIM with respect to x, x * x and x * y, (3, n).
        x: The picture, (n).
        y: The photo, (n).
        dssim: Weight of 1 - SSIM in the loss.
        out: Output: the gradient, (n).
    """
    n = np.float32(x.shape[0])
    structure, absolute = np.float32(-dssim) / n, np.float32(1 - dssim) / n
    two = np.float32(2)
    for i in prange(x.shape[0]):
        slope = gradients[0, i] + two * x[i] * gradients[1, i] + y[i] * gradients[2, i]
        out[i] = structure * slope + absolute * np.sign(x[i] - y[i])
