"""Masked pixels have no influence, and a rectangular mask equals a crop."""

import numpy as np
import pytest

from close import assert_close
from random_numbers import Numbers
from splatwire.errors import InvalidValueError
from splatwire.metrics import black_outside, psnr, ssim
from splatwire.metrics.lpips import load_lpips
from tensor_files import write_lpips_weights

METRICS = {"psnr": psnr, "ssim": ssim}


def pictures(height: int = 40, width: int = 50) -> tuple[np.ndarray, np.ndarray]:
    rng = Numbers(2)
    first = rng.rand(2, height, width, 3)
    return first, (first + 0.2 * rng.randn(*first.shape)).clip(0, 1)


def garbled(images: np.ndarray, masks: np.ndarray, seed: int) -> np.ndarray:
    garbage = Numbers(seed).rand(*images.shape)
    return np.where(masks[..., None], images, garbage)


@pytest.fixture
def masks() -> np.ndarray:
    """An irregular mask and a full one."""
    ragged = Numbers(3).rand(2, 40, 50) < 0.3
    ragged[1] = True
    return ragged


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_pixels_outside_the_mask_change_nothing(metric, masks):
    a, b = pictures()
    expected = metric(a, b, masks)
    assert np.array_equal(metric(garbled(a, masks, 5), garbled(b, masks, 6), masks), expected)
    assert expected[1] == pytest.approx(metric(a, b)[1].item(), rel=1e-5)
    assert abs(expected[0] - metric(a, b)[0]) > 1e-4


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_rectangular_mask_equals_cropping(metric):
    a, b = pictures()
    masks = np.zeros((2, 40, 50), np.bool_)
    masks[:, 7:29, 11:42] = True
    cut = metric(a[:, 7:29, 11:42], b[:, 7:29, 11:42])
    assert_close(metric(a, b, masks), cut, rtol=1e-5, atol=1e-6)


def test_pictures_equal_inside_the_mask_are_equal(masks):
    a, _ = pictures()
    other = garbled(a, masks, 5)
    assert psnr(a, other, masks)[0] == float("inf")
    assert ssim(a, other, masks)[0] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_empty_mask_is_refused(metric, masks):
    masks[1] = False
    with pytest.raises(InvalidValueError, match="leaves nothing"):
        metric(*pictures(), masks)


@pytest.mark.slow
def test_masked_lpips_ignores_pixels_outside(tmp_path):
    lpips = load_lpips(*write_lpips_weights(tmp_path), "alex")
    a, b = pictures(64, 70)
    masks = np.zeros((2, 64, 70), np.bool_)
    masks[:, 10:50, 5:40] = True
    inside = lpips(black_outside(a, masks), black_outside(b, masks))
    again = lpips(black_outside(garbled(a, masks, 5), masks), black_outside(garbled(b, masks, 6), masks))
    assert np.array_equal(inside, again)
    assert 0 < inside[0] < lpips(a, b)[0]
