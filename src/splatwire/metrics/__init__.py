"""How far a picture, or what a mask leaves of it, is from a reference: PSNR, SSIM, LPIPS; one number per view."""

from splatwire.metrics.lpips import Lpips, find_lpips
from splatwire.metrics.masks import black_outside
from splatwire.metrics.psnr import decibels, psnr, psnr_by_channel
from splatwire.metrics.ssim import ssim

__all__ = [
    "Lpips",
    "black_outside",
    "decibels",
    "find_lpips",
    "psnr",
    "psnr_by_channel",
    "ssim",
]
