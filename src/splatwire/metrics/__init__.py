"""How far a picture is from a reference: PSNR, SSIM, LPIPS; one number per view."""

from splatwire.metrics.lpips import Lpips as Lpips
from splatwire.metrics.lpips import find_lpips as find_lpips
from splatwire.metrics.psnr import psnr as psnr
from splatwire.metrics.psnr import psnr_by_channel as psnr_by_channel
from splatwire.metrics.ssim import ssim as ssim
