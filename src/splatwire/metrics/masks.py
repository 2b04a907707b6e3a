"""Pictures of which only a part counts: pixels outside of a mask have no influence on any figure."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy


def black_outside(images: Float[Any, "C H W 3"], masks: Bool[Any, "C H W"]) -> Float[np.ndarray, "C H W 3"]:
    """Turns everything outside the masks black, as what is beyond the border is to a convolution.

    A metric that looks at neighbourhoods (SSIM, LPIPS) gets both pictures so: equal outside, whatever was there.

    Args:
        images: RGB in [0, 1].
        masks: True where pixels count.
    """
    pictures = to_numpy(images)
    return np.where(to_numpy(masks)[..., None], pictures, pictures.dtype.type(0))


def mean_inside(
    values: Float[np.ndarray, "C H W 3"], masks: Bool[Any, "C H W"] | None = None
) -> Float[np.ndarray, "C"]:
    """Means of each view over the pixels that count and all channels.

    Args:
        values: Something of each pixel.
        masks: True where pixels count; all of them for None.

    Raises:
        InvalidValueError: If a mask leaves nothing of its view.
    """
    if masks is None:
        return values.mean(axis=(1, 2, 3))
    left = to_numpy(masks).sum(axis=(1, 2))
    if not bool((left > 0).all()):
        raise InvalidValueError("a mask leaves nothing of its picture to compare")
    return (black_outside(values, masks).sum(axis=(1, 2, 3)) / (3 * left)).astype(values.dtype)
