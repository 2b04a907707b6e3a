"""How far a picture, or what a mask leaves of it, is from a reference: PSNR, SSIM, LPIPS; one number per view."""

from splatwire.metrics.lpips import Lpips as Lpips
from splatwire.metrics.lpips import find_lpips as find_lpips
from splatwire.metrics.masks import black_outside as black_outside
from splatwire.metrics.psnr import psnr as psnr
from splatwire.metrics.psnr import psnr_by_channel as psnr_by_channel
from splatwire.metrics.ssim import ssim as ssim
