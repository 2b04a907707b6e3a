"""Pictures of which only a part counts: what a mask leaves out has no influence on any figure."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.errors import InvalidValueError


def black_outside(images: Float[Tensor, "C H W 3"], masks: Bool[Tensor, "C H W"]) -> Float[Tensor, "C H W 3"]:
    """Turns everything outside the masks black, as what is beyond the border is to a convolution.

    A metric that looks at neighbourhoods (SSIM, LPIPS) gets both pictures so: equal outside, whatever was there.

    Args:
        images: RGB in [0, 1].
        masks: True where pixels count.
    """
    return torch.where(masks[..., None], images, torch.zeros_like(images))


def mean_inside(values: Float[Tensor, "C H W 3"], masks: Bool[Tensor, "C H W"] | None = None) -> Float[Tensor, "C"]:
    """Means of each view over the pixels that count and all channels.

    Args:
        values: Something of each pixel.
        masks: True where pixels count; all of them for None.

    Raises:
        InvalidValueError: If a mask leaves nothing of its view.
    """
    if masks is None:
        return values.mean(dim=(1, 2, 3))
    left = masks.sum(dim=(1, 2))
    if not bool((left > 0).all()):
        raise InvalidValueError("a mask leaves nothing of its picture to compare")
    return black_outside(values, masks).sum(dim=(1, 2, 3)) / (3 * left)
