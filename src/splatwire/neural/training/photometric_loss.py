"""Photometric loss: difference of a rendered picture from a photo, by default 0.8 L1 + 0.2 (1 - SSIM) (HAC++)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.metrics.ssim import SIGMA, WINDOW
from splatwire.neural.training import _loss_kernels as kernels

C1, C2 = 0.01**2, 0.03**2


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo with the terms of SSIM that depend only on the photo, computed in advance.

    Attributes:
        image: RGB in [0, 1].
        moments: Blurred values and blurred squares; None for a photo with a mask.
        mask: True for pixels that are compared; None if all pixels are compared.
    """

    # Masked pixels are later replaced by the rendered picture, so their moments cannot be computed in advance.

    image: Float[Tensor, "H W 3"]
    moments: Float[Tensor, "2 H W 3"] | None
    mask: Bool[Tensor, "H W"] | None = None


def prepare_photo(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> Photo:
    """Prepares a photo for `photometric_loss`: precomputes the blurred values and blurred squares that SSIM needs.

    The result can be used for any number of rendered pictures. Nothing is precomputed for a photo with a mask.

    Args:
        image: The photo, RGB in [0, 1], on the CPU.
        mask: True for pixels that are compared; None if all pixels are compared.
    """
    if mask is not None:
        return Photo(image, None, mask)
    pixels = image.contiguous().numpy()
    moments = np.empty((2, *pixels.shape), np.float32)
    kernels.blur(_rows(np.stack([pixels, pixels * pixels])), window_taps(), _rows(moments))
    return Photo(image, torch.from_numpy(moments))


def photometric_loss(
    image: Float[Tensor, "H W 3"], photo: Photo, dssim: float
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Computes the training loss of a rendered picture on the CPU, compiled; differentiable in the picture.

    Args:
        image: The picture, RGB, not clamped.
        photo: The target. Pixels outside its mask have no influence.
        dssim: Weight of 1 - SSIM; the weight of the mean absolute error is 1 - `dssim`.

    Returns:
        The loss, and the mean absolute error without a gradient.
    """
    if photo.mask is not None:
        photo = prepare_photo(torch.where(photo.mask[:, :, None], photo.image, image.detach()))
    loss, error = _PhotometricLoss.apply(image, photo, dssim)
    return loss, error


class _PhotometricLoss(torch.autograd.Function):
    """Autograd function of the photometric loss."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, photo: Photo, dssim: float) -> tuple[Tensor, Tensor]:
        assert photo.moments is not None
        x, y = image.detach().contiguous().numpy(), photo.image.numpy()
        photo_moments, products, taps = photo.moments.numpy(), np.empty((3, *x.shape), np.float32), window_taps()
        kernels.products(_flat(x), _flat(y), products.reshape(3, -1))
        moments = np.empty_like(products)
        kernels.blur(_rows(products), taps, _rows(moments))
        sums = np.empty((x.shape[0], 2), np.float64)
        kernels.similarity(_rows(moments), _rows(photo_moments), _rows(x[None])[0], _rows(y[None])[0], C1, C2, sums)
        gradients = products  # reuses the memory; `similarity` has replaced the moments by their gradients
        kernels.blur(_rows(moments), taps, _rows(gradients))
        result = np.empty_like(x)
        kernels.combine(gradients.reshape(3, -1), _flat(x), _flat(y), dssim, _flat(result))
        structure, error = sums.sum(axis=0) / x.size
        ctx.save_for_backward(torch.from_numpy(result))
        value = (1 - dssim) * error + dssim * (1 - structure)
        absolute = image.new_tensor(error)
        ctx.mark_non_differentiable(absolute)
        return image.new_tensor(value), absolute

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * upstream[0], None, None


def window_taps() -> np.ndarray:
    """Returns the weights of SSIM's Gaussian window along one axis, float32."""
    x = np.arange(WINDOW, dtype=np.float64) - WINDOW // 2
    taps = np.exp(-x * x / (2 * SIGMA**2))
    return (taps / taps.sum()).astype(np.float32)


def _rows(planes: np.ndarray) -> np.ndarray:
    """Reshapes images (P, H, W, 3) to rows of RGB values (P, H, 3 W)."""
    return planes.reshape(planes.shape[0], planes.shape[1], -1)


def _flat(image: np.ndarray) -> np.ndarray:
    return image.reshape(-1)
