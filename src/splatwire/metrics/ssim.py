"""Structural similarity with the constants of 3DGS and its successors."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import checked
from splatwire.metrics.masks import black_outside, image_pair, mean_inside
from splatwire.ops.arrays import to_numpy

WINDOW = 11
SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2


@checked
def ssim(
    images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"], masks: Bool[Any, "C H W"] | None = None
) -> Float[np.ndarray, "C"]:
    """Computes the mean SSIM of each of C views, over all pixels and channels.

    Args:
        images: Pictures of the C views, RGB in [0, 1].
        references: Reference pictures of the same views, RGB in [0, 1].
        masks: True for pixels that count; None for all.

    Returns:
        Mean SSIM of each view; 1 if a view equals its reference.

    Raises:
        InvalidValueError: If a mask is empty.
    """
    images, references = image_pair(images, references)
    if masks is not None:
        images, references = black_outside(images, masks), black_outside(references, masks)
    return mean_inside(ssim_map(images, references), masks)


def ssim_map(images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"]) -> Float[np.ndarray, "C H W 3"]:
    """Computes SSIM at every pixel and channel of C views.

    As in 3DGS, the window is a Gaussian of 11x11 pixels with sigma 1.5, variances are population variances, and
    pixels outside the picture are 0.

    Args:
        images: Pictures of the C views, RGB in [0, 1].
        references: Reference pictures of the same views, RGB in [0, 1].

    Returns:
        SSIM per view, pixel and channel.
    """
    x, y = to_numpy(images), to_numpy(references)
    mean_x, mean_y, xx, yy, xy = (_blur(moment) for moment in (x, y, x * x, y * y, x * y))
    var_x, var_y, cov = xx - mean_x * mean_x, yy - mean_y * mean_y, xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + _C1) / (mean_x * mean_x + mean_y * mean_y + _C1)
    return luminance * (2 * cov + _C2) / (var_x + var_y + _C2)


def _blur(images: Float[np.ndarray, "C H W 3"]) -> Float[np.ndarray, "C H W 3"]:
    """Blurs images with the Gaussian window of SSIM and zero padding."""
    from scipy.ndimage import correlate1d  # takes long to load

    x = np.arange(WINDOW) - WINDOW // 2
    taps = np.exp(-x * x / (2 * SIGMA**2))
    taps /= taps.sum()
    columns = correlate1d(images, taps, axis=1, mode="constant")
    return correlate1d(columns, taps, axis=2, mode="constant")
