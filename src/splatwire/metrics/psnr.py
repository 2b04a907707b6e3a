"""Peak signal-to-noise ratio."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import array_of, checked
from splatwire.metrics.masks import black_outside, image_pair, mean_inside


@checked
def decibels(mse: Float[Any, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Converts mean squared errors of values in [0, 1] to PSNR in decibels."""
    errors = array_of(mse, "mse", None)
    with np.errstate(divide="ignore", invalid="ignore"):
        return -10 * np.log10(errors)


@checked
def psnr(
    images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"], masks: Bool[Any, "C H W"] | None = None
) -> Float[np.ndarray, "C"]:
    """Computes the PSNR of each of C views over all pixels and channels, as in published tables.

    Args:
        images: Pictures of the C views, RGB in [0, 1].
        references: Reference pictures of the same views, RGB in [0, 1].
        masks: True for pixels that are evaluated; None for all.

    Returns:
        PSNR of each view in decibels; infinite if a view equals its reference.

    Raises:
        InvalidValueError: If a mask is empty.
    """
    ours, theirs = image_pair(images, references)
    if masks is not None:
        ours, theirs = black_outside(ours, masks), black_outside(theirs, masks)
    return decibels(mean_inside((ours - theirs) ** 2, masks))


@checked
def psnr_by_channel(images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"]) -> Float[np.ndarray, "C"]:
    """Computes, for each of C views, the mean of the PSNRs of the red, green and blue channels.

    The training logs of 3DGS and HAC++ show this number as PSNR. It is up to some tenths of a decibel higher than the
    PSNR in published tables, which `psnr` computes from the error of all three colours together.

    Args:
        images: Pictures of the C views, RGB in [0, 1].
        references: Reference pictures of the same views, RGB in [0, 1].

    Returns:
        Mean of the three PSNRs for each view, decibels.
    """
    ours, theirs = image_pair(images, references)
    return decibels(((ours - theirs) ** 2).mean(axis=(1, 2))).mean(axis=1)
