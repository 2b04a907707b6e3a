"""Peak signal-to-noise ratio."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.metrics.masks import black_outside, mean_inside


def decibels(mse: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """PSNR of mean squared errors of values in [0, 1]; infinite for 0."""
    return -10 * torch.log10(mse)


def psnr(
    images: Float[Tensor, "C H W 3"], references: Float[Tensor, "C H W 3"], masks: Bool[Tensor, "C H W"] | None = None
) -> Float[Tensor, "C"]:
    """Computes the PSNR of each view over all its pixels and channels, as published tables do.

    Args:
        images: RGB in [0, 1].
        references: RGB in [0, 1].
        masks: True where pixels count; all of them for None.

    Returns:
        Decibels, one per view; infinite where a view equals its reference.

    Raises:
        InvalidValueError: If a mask leaves nothing of its view.
    """
    if masks is not None:
        images, references = black_outside(images, masks), black_outside(references, masks)
    return decibels(mean_inside((images - references).square(), masks))


def psnr_by_channel(images: Float[Tensor, "C H W 3"], references: Float[Tensor, "C H W 3"]) -> Float[Tensor, "C"]:
    """Computes the mean of the PSNRs of the three channels, what the training logs of 3DGS and HAC++ call PSNR.

    It is never below `psnr`, by up to some tenths of a decibel; not for tables.

    Args:
        images: RGB in [0, 1].
        references: RGB in [0, 1].

    Returns:
        Decibels, one per view.
    """
    mse = (images - references).square().mean(dim=(1, 2))
    return decibels(mse).mean(dim=1)
