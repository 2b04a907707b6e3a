"""The photometric loss in plain torch with gradients from autograd."""

import torch

from splatwire.metrics.ssim import SIGMA, WINDOW


def photometric_loss_reference(
    image: torch.Tensor, photo: torch.Tensor, dssim: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Value of `splatwire.neural.training.photometric_loss.photometric_loss`."""
    error = (image - photo).abs().mean()
    return (1 - dssim) * error + dssim * (1 - structural_similarity(image, photo)), error.detach()


def structural_similarity(image: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
    """Mean SSIM of two pictures (H, W, 3), zeros outside the border (Wang et al. 2004)."""
    place = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    taps = torch.exp(-(place**2) / (2 * SIGMA**2))
    taps = (taps / taps.sum()).to(image)
    window = (taps[:, None] * taps).expand(3, 1, WINDOW, WINDOW)

    def local_mean(values: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(values.permute(2, 0, 1)[None], window, padding=WINDOW // 2, groups=3)

    mean_x, mean_y = local_mean(image), local_mean(photo)
    squares = local_mean(image**2) - mean_x**2 + local_mean(photo**2) - mean_y**2
    covariance = local_mean(image * photo) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2)
    return (luminance * (2 * covariance + 0.03**2) / (squares + 0.03**2)).mean()
