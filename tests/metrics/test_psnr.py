import math

import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr, psnr_by_channel, ssim
from splatwire.metrics.masks import image_pair


def test_known_error_has_the_expected_psnr() -> None:
    """An error of 0.1 everywhere is 20 dB; one of 0.1 in one channel of three is 20 + 10 log10 3."""
    references = np.full((2, 4, 5, 3), 0.5, np.float32)
    images = references + 0.1
    images[1, ..., 1:] = 0.5
    assert psnr(images, references).tolist() == pytest.approx([20.0, 20 + 10 * math.log10(3)], abs=1e-4)


def test_equal_pictures_have_infinite_psnr() -> None:
    image = Numbers(0).rand(1, 3, 3, 3)
    assert psnr(image, image).tolist() == [math.inf]


def test_channel_mean_of_psnr_is_at_least_the_joint_psnr() -> None:
    generator = Numbers(0)
    a, b = generator.rand(2, 1, 8, 8, 3)
    uneven = b.copy()
    uneven[..., 0] = a[..., 0] + 0.01
    assert psnr_by_channel(a, uneven) > psnr(a, uneven) + 1
    flat = a + 0.1
    assert psnr_by_channel(a, flat).item() == pytest.approx(psnr(a, flat).item(), abs=1e-3)


@pytest.mark.parametrize("metric", [psnr, psnr_by_channel, ssim])
def test_pictures_of_eight_bits_are_an_error(metric) -> None:
    """Differences of unsigned integers wrap around, and those of floats up to 255 mean no decibels."""
    image = Numbers(0).rand(1, 16, 16, 3)
    for ours, theirs in ((image, 255 * image), (255 * image, image)):
        with pytest.raises(InvalidValueError, match=r"expected RGB from 0 to 1, not float32 up to 2.*divide by 255"):
            metric(ours, theirs)
    with pytest.raises(InvalidValueError, match="expected RGB from 0 to 1, not uint8 up to"):
        image_pair(image, (255 * image).astype(np.uint8))


@pytest.mark.parametrize("metric", [psnr, psnr_by_channel, ssim])
def test_pictures_scaled_for_networks_are_an_error(metric) -> None:
    image = Numbers(0).rand(1, 16, 16, 3)
    for ours, theirs in ((image, 2 * image - 1), (2 * image - 1, image)):
        with pytest.raises(InvalidValueError, match=r"expected RGB from 0 to 1, not from -0\.\d+: .*\(x \+ 1\) / 2"):
            metric(ours, theirs)


@pytest.mark.parametrize("metric", [psnr, psnr_by_channel, ssim])
@pytest.mark.parametrize("dtype", ["float16", ">f4"])
def test_pictures_of_other_number_types_are_compared_in_float32(metric, dtype) -> None:
    """A square of a small difference is 0 in float16."""
    image = Numbers(0).rand(1, 16, 16, 3)
    ours, theirs = image.astype(dtype), (image + 1e-4).astype(dtype)
    expected = metric(ours.astype(np.float32), theirs.astype(np.float32))
    assert np.array_equal(metric(ours, theirs), expected)
