"""Structural similarity with the constants that 3DGS and its successors use."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.metrics.masks import black_outside, mean_inside

WINDOW = 11
SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2


def ssim(
    images: Float[Tensor, "C H W 3"], references: Float[Tensor, "C H W 3"], masks: Bool[Tensor, "C H W"] | None = None
) -> Float[Tensor, "C"]:
    """Computes the mean SSIM of each view (`ssim_map`); differentiable.

    Args:
        images: RGB in [0, 1].
        references: RGB in [0, 1].
        masks: True where pixels count; all of them for None. What is outside a mask is what is beyond the border, so a
            mask that is a rectangle gives what the cut-out would give.

    Returns:
        One number per view, 1 where a view equals its reference.

    Raises:
        InvalidValueError: If a mask leaves nothing of its view.
    """
    if masks is not None:
        images, references = black_outside(images, masks), black_outside(references, masks)
    return mean_inside(ssim_map(images, references), masks)


def ssim_map(images: Float[Tensor, "C H W 3"], references: Float[Tensor, "C H W 3"]) -> Float[Tensor, "C H W 3"]:
    """Computes SSIM at every pixel and channel.

    Gaussian window of 11x11 and sigma 1.5, population variances, zeros beyond the border as in 3DGS: the outer 5
    pixels therefore differ from implementations that mirror or crop.

    Args:
        images: RGB in [0, 1].
        references: RGB in [0, 1].

    Returns:
        SSIM per pixel and channel.
    """
    moments = torch.cat([images, references, images * images, references * references, images * references])
    mean_x, mean_y, xx, yy, xy = _blur(moments).chunk(5)
    var_x, var_y, cov = xx - mean_x * mean_x, yy - mean_y * mean_y, xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + _C1) / (mean_x * mean_x + mean_y * mean_y + _C1)
    return luminance * (2 * cov + _C2) / (var_x + var_y + _C2)


def _blur(images: Float[Tensor, "B H W 3"]) -> Float[Tensor, "B H W 3"]:
    """Gaussian blur, one axis after the other; the channels-last view is what makes the convolution quick."""
    x = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    taps = torch.exp(-x * x / (2 * SIGMA**2))
    taps = (taps / taps.sum()).to(images)
    planes = images.permute(0, 3, 1, 2)
    column = taps.view(1, 1, WINDOW, 1).expand(3, 1, WINDOW, 1)
    planes = torch.nn.functional.conv2d(planes, column, padding=(WINDOW // 2, 0), groups=3)
    planes = torch.nn.functional.conv2d(planes, column.transpose(2, 3), padding=(0, WINDOW // 2), groups=3)
    return planes.permute(0, 2, 3, 1)
