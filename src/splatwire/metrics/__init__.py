"""Distances of pictures from references, inside masks: PSNR and SSIM; LPIPS (`splatwire.metrics.lpips`) needs torch."""

from splatwire.metrics.masks import black_outside
from splatwire.metrics.psnr import decibels, psnr, psnr_by_channel
from splatwire.metrics.ssim import ssim

__all__ = [
    "black_outside",
    "decibels",
    "psnr",
    "psnr_by_channel",
    "ssim",
]
