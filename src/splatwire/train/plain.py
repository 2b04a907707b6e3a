"""The heavy parts of an iteration in torch operations alone, for any device: twins of the compiled ones.

They are written for a GPU: nothing waits for a number from the device, sorts, or is rounded to TensorFloat.
"""

from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor
from torch.nn.functional import pad

from splatwire.metrics.ssim import WINDOW
from splatwire.train.adam import BETA1, BETA2, EPSILON, count_update
from splatwire.train.grid import GridCorners, hard_sign
from splatwire.train.losses import C1, C2, Photo, window_taps
from splatwire.train.state import Moments


def interpolate_signs_plain(
    volume: Float[Tensor, "rows3 D"],
    planes: Float[Tensor, "3 rows2 D"],
    corners: GridCorners,
    index: Int64[Tensor, "M"],
) -> Float[Tensor, "M H"]:
    """Interpolates the signs of the tables; arguments and gradient as in `splatwire.train.grid.interpolate_signs`.

    Level by level, so that memory grows with positions, not with positions times levels. On a GPU the gradient is
    summed in no fixed order.
    """
    features: Tensor = _InterpolateSigns.apply(torch.cat([volume, planes.flatten(0, 1)]), corners, index)
    return features


class _InterpolateSigns(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tables: Tensor, corners: GridCorners, index: Tensor) -> Tensor:
        signs = hard_sign(tables.detach())
        levels = []
        for rows, weights in _levels(corners, index):
            values = signs.index_select(0, rows.flatten()).view(*rows.shape, tables.shape[1])
            levels.append((values * weights.to(values)[:, :, None]).sum(dim=1))
        ctx.corners, ctx.index = corners, index
        ctx.save_for_backward(tables)
        return torch.cat(levels, dim=1)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        (tables,) = ctx.saved_tensors
        gradient, depth = torch.zeros_like(tables), tables.shape[1]
        columns = upstream[0].split(depth, dim=1)
        for (rows, weights), column in zip(_levels(ctx.corners, ctx.index), columns, strict=True):
            shares = weights.to(column)[:, :, None] * column[:, None, :]
            gradient.index_add_(0, rows.flatten(), shares.flatten(0, 1))
        return gradient * (tables.abs() <= 1), None, None


def _levels(
    corners: GridCorners, index: Int64[Tensor, "M"]
) -> Iterator[tuple[Int32[Tensor, "M corners"], Float[Tensor, "M corners"]]]:
    """Rows and weights of the chosen positions, level by level, the volume first."""
    for rows, weights in (
        (corners.volume_rows, corners.volume_weights),
        (corners.plane_rows, corners.plane_weights),
    ):
        for level in range(len(rows)):
            yield rows[level].index_select(0, index), weights[level].index_select(0, index)


def prepare_photo_plain(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> Photo:
    """Computes what the loss needs of a photo, where the photo is."""
    return Photo(image, None if mask is not None else blur(torch.stack([image, image * image])), mask)


def blur(images: Float[Tensor, "P H W 3"]) -> Float[Tensor, "P H W 3"]:
    """Blurs with the window of SSIM, zeros beyond the border.

    A weighted sum of shifted pictures: a convolution would be rounded to TensorFloat on some GPUs, and the variances of
    SSIM, differences of nearly equal numbers, do not stand that.
    """
    half, taps = WINDOW // 2, window_taps().tolist()
    for axis, border in ((1, (0, 0, 0, 0, half, half)), (2, (0, 0, half, half))):
        wide, size = pad(images, border), images.shape[axis]
        images = wide.narrow(axis, 0, size) * taps[0]
        for shift in range(1, WINDOW):
            images.add_(wide.narrow(axis, shift, size), alpha=taps[shift])
    return images


def photometric_loss_plain(
    image: Float[Tensor, "H W 3"], photo: Photo, dssim: float
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Computes the loss of a picture; arguments and result as in `splatwire.train.losses.photometric_loss`."""
    if photo.mask is not None:
        photo = prepare_photo_plain(torch.where(photo.mask[:, :, None], photo.image, image.detach()))
    loss, error = _PhotometricLoss.apply(image, photo, dssim)
    return loss, error


class _PhotometricLoss(torch.autograd.Function):
    """Computes the gradient together with the value: two blurs of three pictures instead of autograd's many passes."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, photo: Photo, dssim: float) -> tuple[Tensor, Tensor]:
        assert photo.moments is not None
        x, y = image.detach(), photo.image
        blurred = blur(torch.stack([x, x * x, x * y]))
        structure, d_moments = _similarity(blurred, photo.moments)
        along, squared, crossed = blur(d_moments)
        slope = along + 2 * x * squared + y * crossed
        gradient = ((1 - dssim) * torch.sign(x - y) - dssim * slope) / x.numel()
        error = (x - y).abs().mean()
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(error)
        return (1 - dssim) * error + dssim * (1 - structure), error

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * upstream[0], None, None


def _similarity(
    own: Float[Tensor, "3 H W 3"], other: Float[Tensor, "2 H W 3"]
) -> tuple[Float[Tensor, ""], Float[Tensor, "3 H W 3"]]:
    """Mean SSIM, and the gradient of its sum in the blurred picture, its square and its product with the photo."""
    (mean_x, xx, xy), (mean_y, yy) = own, other
    over_means = 1 / (mean_x * mean_x + mean_y * mean_y + C1)
    over_spreads = 1 / ((xx - mean_x * mean_x) + (yy - mean_y * mean_y) + C2)
    luminance = (2 * mean_x * mean_y + C1) * over_means
    contrast = (2 * (xy - mean_x * mean_y) + C2) * over_spreads
    value = luminance * contrast
    d_squared, d_crossed = -value * over_spreads, 2 * luminance * over_spreads
    d_mean = 2 * (mean_y * contrast - value * mean_x) * over_means - mean_y * d_crossed - 2 * mean_x * d_squared
    return value.mean(), torch.stack([d_mean, d_squared, d_crossed])


@torch.no_grad()
def adam_update_plain(parameter: Tensor, gradient: Tensor, moments: Moments, rate: float) -> None:
    """Updates `parameter` and `moments` in place; arguments as in `splatwire.train.adam.adam_update`."""
    step_size, root = count_update(moments, rate)
    moments.first.lerp_(gradient, 1 - BETA1)
    moments.second.mul_(BETA2).addcmul_(gradient, gradient, value=1 - BETA2)
    denominator = (moments.second.sqrt() / root).add_(EPSILON)
    parameter.addcdiv_(moments.first, denominator, value=-step_size)
