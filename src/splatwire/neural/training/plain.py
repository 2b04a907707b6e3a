"""The expensive operations of training in plain torch; they run on any device and are optimised for GPUs."""

# Few operations, no synchronisation with the device, no sorting. No operation uses the reduced precision
# TensorFloat-32.

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor
from torch.nn.functional import conv2d

from splatwire.metrics.ssim import WINDOW
from splatwire.neural.training.adam import BETA1, BETA2, EPSILON, AdamUpdate
from splatwire.neural.training.grid import GridCorners, hard_sign
from splatwire.neural.training.photometric_loss import C1, C2, Photo, window_taps


def interpolate_signs_plain(
    volume: Float[Tensor, "rows3 D"],
    planes: Float[Tensor, "3 rows2 D"],
    corners: GridCorners,
    index: Int64[Tensor, "M"],
) -> Float[Tensor, "M H"]:
    """Interpolates the binary hash grid, like `neural.training.grid.interpolate_signs` but in plain torch."""
    # Levels are processed one after another, so that memory is proportional to the number of positions, not to
    # positions times levels. On a GPU the order of the gradient's sums is not fixed, so rounding may differ between
    # calls.
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
    """Yields the table rows and weights with which each level of the hash grid is interpolated."""
    for rows, weights in (
        (corners.volume_rows, corners.volume_weights),
        (corners.plane_rows, corners.plane_weights),
    ):
        for level in range(len(rows)):
            yield rows[level].index_select(0, index), weights[level].index_select(0, index)


def prepare_photo_plain(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> Photo:
    """Precomputes the terms of the photometric loss that depend only on the photo, in plain torch.

    Args:
        image: The photo, RGB in [0, 1].
        mask: True for pixels that are compared; None for all. With a mask, nothing is precomputed.
    """
    if mask is not None:
        return Photo(image, None, mask)
    planes = image.permute(2, 0, 1)
    moments = blur(torch.cat([planes, planes * planes]))
    return Photo(image, moments.unflatten(0, (2, 3)).permute(0, 2, 3, 1))


def blur(planes: Float[Tensor, "P H W"]) -> Float[Tensor, "P H W"]:
    """Blurs image planes with the Gaussian window of SSIM; pixels outside the image count as 0."""
    # cuDNN is disabled because it rounds to TensorFloat-32 on some GPUs. That is too imprecise for the variances of
    # SSIM, which are differences of nearly equal numbers. Torch's own convolution of separate planes has float32
    # precision.
    count, half = len(planes), WINDOW // 2
    down, across = _windows(count, planes.device)
    with torch.backends.cudnn.flags(enabled=False):
        blurred = conv2d(planes[None], down, padding=(half, 0), groups=count)
        return conv2d(blurred, across, padding=(0, half), groups=count)[0]


@lru_cache(maxsize=8)
def _windows(count: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Returns the Gaussian window of SSIM as convolution weights for `count` planes, along columns and along rows."""
    taps = torch.from_numpy(window_taps()).to(device).repeat(count, 1)
    return taps[:, None, :, None], taps[:, None, None, :]


def photometric_loss_plain(
    image: Float[Tensor, "H W 3"], photo: Photo, dssim: float
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Computes the loss of a rendered picture; arguments and result as in the module `photometric_loss`."""
    if photo.mask is not None:
        photo = prepare_photo_plain(torch.where(photo.mask[:, :, None], photo.image, image.detach()))
    loss, error = _PhotometricLoss.apply(image, photo, dssim)
    return loss, error


class _PhotometricLoss(torch.autograd.Function):
    """Photometric loss (L1 and D-SSIM) as an autograd function with an explicit gradient."""

    # The gradient is computed in the forward pass. It needs fewer blurred images than automatic differentiation of
    # SSIM.

    @staticmethod
    def forward(ctx: Any, image: Tensor, photo: Photo, dssim: float) -> tuple[Tensor, Tensor]:
        assert photo.moments is not None
        x, y = image.detach().permute(2, 0, 1), photo.image.permute(2, 0, 1)
        blurred = blur(torch.cat([x, x * x, x * y])).unflatten(0, (3, 3))
        structure, d_moments = _similarity(blurred, photo.moments.permute(0, 3, 1, 2))
        slope, squared, crossed = blur(d_moments.flatten(0, 1)).unflatten(0, (3, 3))
        difference, count = x - y, x.numel()
        gradient = slope.addcmul_(x, squared, value=2).addcmul_(y, crossed).mul_(-dssim / count)
        gradient.add_(difference.sign(), alpha=(1 - dssim) / count)
        error = difference.abs_().mean()
        ctx.save_for_backward(gradient.permute(1, 2, 0))
        ctx.mark_non_differentiable(error)
        return ((1 - dssim) * error).add_(structure, alpha=-dssim).add_(dssim), error

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * upstream[0], None, None


def _similarity(
    own: Float[Tensor, "3 3 H W"], other: Float[Tensor, "2 3 H W"]
) -> tuple[Float[Tensor, ""], Float[Tensor, "3 3 H W"]]:
    """Computes the mean SSIM from blurred images, and the gradient of the sum of SSIM with respect to `own`.

    Args:
        own: Blurred picture, its blurred square, and its blurred product with the photo.
        other: Blurred photo and its blurred square.

    Returns:
        The mean, and the gradient.
    """
    (mean_x, xx, xy), (mean_y, yy) = own, other
    square_x, square_y, product = mean_x * mean_x, mean_y * mean_y, mean_x * mean_y
    over_spreads = (xx - square_x).add_(yy - square_y).add_(C2).reciprocal_()
    over_means = square_x.add_(square_y).add_(C1).reciprocal_()
    contrast = (xy - product).mul_(2).add_(C2).mul_(over_spreads)
    luminance = product.mul_(2).add_(C1).mul_(over_means)
    value = luminance * contrast
    gradients = torch.empty_like(own)
    d_mean, d_squared, d_crossed = gradients
    torch.mul(value, over_spreads, out=d_squared).neg_()
    torch.mul(luminance, over_spreads, out=d_crossed).mul_(2)
    torch.mul(mean_y, contrast, out=d_mean).addcmul_(value, mean_x, value=-1).mul_(over_means).mul_(2)
    d_mean.addcmul_(mean_y, d_crossed, value=-1).addcmul_(mean_x, d_squared, value=-2)
    return value.mean(), gradients


@torch.no_grad()
def adam_update_plain(updates: Sequence[AdamUpdate]) -> None:
    """Updates parameters and moments with Adam, in place."""
    # All tensors with the same learning rate and the same number of updates are updated by one call of torch's
    # fused Adam.
    groups: dict[tuple[float, int], list[tuple[Tensor, ...]]] = defaultdict(list)
    for parameter, gradient, moments, rate in updates:
        moments.steps += 1
        groups[rate, moments.steps].append((parameter.detach(), gradient.contiguous(), moments.first, moments.second))
    counts = {steps: torch.full((), float(steps), device=updates[0][0].device) for steps in {key[1] for key in groups}}
    for (rate, steps), members in groups.items():
        parameters, gradients, firsts, seconds = (list(column) for column in zip(*members, strict=True))
        torch._fused_adam_(
            parameters, gradients, firsts, seconds, [], [counts[steps]] * len(parameters), lr=rate, beta1=BETA1,
            beta2=BETA2, weight_decay=0.0, eps=EPSILON, amsgrad=False, maximize=False,
        )  # fmt: skip
