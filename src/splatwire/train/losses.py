"""What training minimises in a picture: 0.8 L1 + 0.2 (1 - SSIM), with a gradient computed in one go (HAC++)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.metrics.ssim import SIGMA, WINDOW

C1, C2 = 0.01**2, 0.03**2


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo, and what SSIM needs of it alone.

    Attributes:
        image: RGB in [0, 1].
        moments: Its blurred values and blurred squares; None of a photo with a mask, which change with the picture.
        mask: True where it counts; None where all of it does.
    """

    image: Float[Tensor, "H W 3"]
    moments: Float[Tensor, "2 H W 3"] | None
    mask: Bool[Tensor, "H W"] | None = None


def prepare_photo(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> Photo:
    """Computes what `photometric_loss` needs of a photo, once; compiled, on the CPU."""
    if mask is not None:
        return Photo(image, None, mask)
    from splatwire.train import _loss_kernels as kernels

    pixels = image.contiguous().numpy()
    moments = np.empty((2, *pixels.shape), np.float32)
    kernels.blur(_rows(np.stack([pixels, pixels * pixels])), window_taps(), _rows(moments))
    return Photo(image, torch.from_numpy(moments))


def photometric_loss(
    image: Float[Tensor, "H W 3"], photo: Photo, dssim: float
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Computes the loss of a picture on the CPU, compiled; differentiable in it.

    Args:
        image: The picture, RGB, not clamped.
        photo: What it should be; what its mask leaves out pulls at nothing.
        dssim: Weight of 1 - SSIM; the mean absolute error has the rest.

    Returns:
        The loss, and the mean absolute error without a gradient.
    """
    if photo.mask is not None:
        photo = prepare_photo(torch.where(photo.mask[:, :, None], photo.image, image.detach()))
    loss, error = _PhotometricLoss.apply(image, photo, dssim)
    return loss, error


class _PhotometricLoss(torch.autograd.Function):
    """Computes the gradient together with the value: nearly all of its parts are the same."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, photo: Photo, dssim: float) -> tuple[Tensor, Tensor]:
        from splatwire.train import _loss_kernels as kernels

        assert photo.moments is not None
        x, y = image.detach().contiguous().numpy(), photo.image.numpy()
        blurred, own, taps = photo.moments.numpy(), np.empty((3, *x.shape), np.float32), window_taps()
        kernels.products(_flat(x), _flat(y), own.reshape(3, -1))
        moments = np.empty_like(own)
        kernels.blur(_rows(own), taps, _rows(moments))
        sums = np.empty((x.shape[0], 2), np.float64)
        kernels.similarity(_rows(moments), _rows(blurred), _rows(x[None])[0], _rows(y[None])[0], C1, C2, sums)
        gradients = own
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
    """Weights of SSIM's Gaussian window along one axis."""
    x = np.arange(WINDOW, dtype=np.float64) - WINDOW // 2
    taps = np.exp(-x * x / (2 * SIGMA**2))
    return (taps / taps.sum()).astype(np.float32)


def _rows(planes: np.ndarray) -> np.ndarray:
    """(P, H, W, 3) as (P, H, 3 W)."""
    return planes.reshape(planes.shape[0], planes.shape[1], -1)


def _flat(image: np.ndarray) -> np.ndarray:
    return image.reshape(-1)
