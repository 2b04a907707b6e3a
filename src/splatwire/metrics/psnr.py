"""Peak signal-to-noise ratio."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.metrics.masks import black_outside, mean_inside
from splatwire.ops.arrays import to_numpy


def decibels(mse: Float[Any, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """PSNR of mean squared errors of values in [0, 1]; infinite for 0."""
    with np.errstate(divide="ignore"):
        return -10 * np.log10(np.asarray(to_numpy(mse)))


def psnr(
    images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"], masks: Bool[Any, "C H W"] | None = None
) -> Float[np.ndarray, "C"]:
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
    ours, theirs = to_numpy(images), to_numpy(references)
    if masks is not None:
        ours, theirs = black_outside(ours, masks), black_outside(theirs, masks)
    return decibels(mean_inside((ours - theirs) ** 2, masks))


def psnr_by_channel(images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"]) -> Float[np.ndarray, "C"]:
    """Computes the mean of the PSNRs of the three channels, what the training logs of 3DGS and HAC++ call PSNR.

    It is never below `psnr`, by up to some tenths of a decibel; not for tables.

    Args:
        images: RGB in [0, 1].
        references: RGB in [0, 1].

    Returns:
        Decibels, one per view.
    """
    return decibels(((to_numpy(images) - to_numpy(references)) ** 2).mean(axis=(1, 2))).mean(axis=1)
