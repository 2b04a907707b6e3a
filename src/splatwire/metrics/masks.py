"""Masks of the pixels that metrics evaluate."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import array_of, checked
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy

_MIN_VALUE, _MAX_VALUE = -0.5, 8.0
"""Smallest and largest value of a picture. Renders that are not clamped may exceed [0, 1] a little. Pictures of 8 bits
reach 255, and pictures for networks are often scaled to [-1, 1]."""


@checked
def black_outside(images: Float[Any, "C H W 3"], masks: Bool[Any, "C H W"]) -> Float[np.ndarray, "C H W 3"]:
    """Sets pixels outside the masks to black, for metrics that compare neighbourhoods of pixels (SSIM, LPIPS).

    Args:
        images: Pictures of C views, RGB in [0, 1].
        masks: True for pixels that are evaluated.
    """
    pictures = array_of(images, "images", ("C", "H", "W", 3))
    kept = array_of(masks, "masks", pictures.shape[:3], "b")
    return np.where(kept[..., None], pictures, pictures.dtype.type(0))


def image_pair(images: Any, references: Any) -> tuple[np.ndarray, np.ndarray]:
    """Converts the pictures and the reference pictures of C views to arrays of the same shape (C, H, W, 3).

    Raises:
        InvalidValueError: If the pictures have different sizes, or values far outside [0, 1], such as those of 8-bit
            pictures.
    """
    ours = _unit_range(array_of(images, "images", ("C", "H", "W", 3)), "images")
    return ours, _unit_range(array_of(references, "references", ours.shape), "references")


def _unit_range(images: np.ndarray, name: str) -> np.ndarray:
    """Checks that pictures have floating-point values in [0, 1], apart from small excesses.

    Args:
        images: The pictures.
        name: Name of the argument, for the message.

    Returns:
        The pictures, float32 or float64.
    """
    if images.dtype.kind != "f" or (images.size and images.max() > _MAX_VALUE):
        largest = images.max() if images.size else 0
        raise InvalidValueError(
            f"{name}: expected RGB from 0 to 1, not {images.dtype} up to {largest:g}: divide by 255"
        )
    if images.size and images.min() < _MIN_VALUE:
        raise InvalidValueError(
            f"{name}: expected RGB from 0 to 1, not from {images.min():g}: for pictures in [-1, 1], use (x + 1) / 2"
        )
    # squares of float16 are inexact, and SciPy's filters do not take it
    return images if images.dtype in (np.float32, np.float64) else images.astype(np.float32)


def mean_inside(
    values: Float[np.ndarray, "C H W 3"], masks: Bool[Any, "C H W"] | None = None
) -> Float[np.ndarray, "C"]:
    """Computes for each of C views the mean of values over the evaluated pixels and their channels.

    Args:
        values: Value per view, pixel and channel.
        masks: True for pixels that are evaluated; None for all.

    Raises:
        InvalidValueError: If a mask is empty.
    """
    if masks is None:
        return values.mean(axis=(1, 2, 3))
    num_pixels = to_numpy(masks).sum(axis=(1, 2))
    if not bool((num_pixels > 0).all()):
        raise InvalidValueError("a mask leaves nothing of its picture to compare")
    return (black_outside(values, masks).sum(axis=(1, 2, 3)) / (3 * num_pixels)).astype(values.dtype)
