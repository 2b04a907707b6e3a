import math

import numpy as np
import pytest
import torch

from splatwire.metrics import psnr, psnr_by_channel


def test_known_error_has_the_known_decibels() -> None:
    """An error of 0.1 everywhere is 20 dB; one of 0.1 in one channel of three is 20 + 10 log10 3."""
    references = np.full((2, 4, 5, 3), 0.5, np.float32)
    images = references + 0.1
    images[1, ..., 1:] = 0.5
    assert psnr(images, references).tolist() == pytest.approx([20.0, 20 + 10 * math.log10(3)], abs=1e-4)


def test_equal_pictures_are_infinitely_good() -> None:
    image = torch.rand(1, 3, 3, 3, generator=torch.Generator().manual_seed(0)).numpy()
    assert psnr(image, image).tolist() == [math.inf]


def test_mean_over_channels_is_never_below_the_whole() -> None:
    generator = torch.Generator().manual_seed(0)
    a, b = torch.rand(2, 1, 8, 8, 3, generator=generator).numpy()
    uneven = b.copy()
    uneven[..., 0] = a[..., 0] + 0.01
    assert psnr_by_channel(a, uneven) > psnr(a, uneven) + 1
    flat = a + 0.1
    assert psnr_by_channel(a, flat).item() == pytest.approx(psnr(a, flat).item(), abs=1e-3)
