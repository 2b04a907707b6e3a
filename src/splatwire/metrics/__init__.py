"""Image quality metrics, with masks: PSNR and SSIM, and LPIPS (`splatwire.metrics.lpips`)."""

from splatwire.metrics.masks import black_outside
from splatwire.metrics.psnr import decibels, psnr, psnr_by_channel
from splatwire.metrics.registry import register_metric
from splatwire.metrics.ssim import ssim

__all__ = [
    "black_outside",
    "decibels",
    "psnr",
    "psnr_by_channel",
    "register_metric",
    "ssim",
]
