"""The photometric loss in plain torch, whose gradient autograd finds."""

import torch

from splatwire.metrics import ssim


def photometric_loss_reference(
    image: torch.Tensor, photo: torch.Tensor, dssim: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """What `splatwire.train.losses.photometric_loss` returns."""
    error = (image - photo).abs().mean()
    structure = ssim(image[None], photo[None])[0]
    return (1 - dssim) * error + dssim * (1 - structure), error.detach()
