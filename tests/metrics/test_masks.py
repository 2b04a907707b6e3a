"""Masks: what they leave out has no influence, and a rectangle is what the cut-out is."""

import numpy as np
import pytest
import torch

from close import assert_close
from metrics.test_lpips import write_weights
from splatwire.errors import InvalidValueError
from splatwire.metrics import black_outside, psnr, ssim
from splatwire.metrics.lpips import load_lpips

METRICS = {"psnr": psnr, "ssim": ssim}


def pictures(height: int = 40, width: int = 50) -> tuple[np.ndarray, np.ndarray]:
    rng = torch.Generator().manual_seed(2)
    first = torch.rand(2, height, width, 3, generator=rng).numpy()
    return first, (first + 0.2 * torch.randn(first.shape, generator=rng).numpy()).clip(0, 1)


def garbled(images: np.ndarray, masks: np.ndarray, seed: int) -> np.ndarray:
    garbage = torch.rand(images.shape, generator=torch.Generator().manual_seed(seed)).numpy()
    return np.where(masks[..., None], images, garbage)


@pytest.fixture
def masks() -> np.ndarray:
    """A ragged one and a full one."""
    ragged = torch.rand(2, 40, 50, generator=torch.Generator().manual_seed(3)).numpy() < 0.3
    ragged[1] = True
    return ragged


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_garbage_outside_changes_nothing(metric, masks):
    a, b = pictures()
    expected = metric(a, b, masks)
    assert np.array_equal(metric(garbled(a, masks, 5), garbled(b, masks, 6), masks), expected)
    assert expected[1] == pytest.approx(metric(a, b)[1].item(), rel=1e-5)
    assert abs(expected[0] - metric(a, b)[0]) > 1e-4


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_a_rectangle_is_the_cut_out(metric):
    a, b = pictures()
    masks = np.zeros((2, 40, 50), np.bool_)
    masks[:, 7:29, 11:42] = True
    cut = metric(a[:, 7:29, 11:42], b[:, 7:29, 11:42])
    assert_close(metric(a, b, masks), cut, rtol=1e-5, atol=1e-6)


def test_equal_inside_is_equal(masks):
    a, _ = pictures()
    other = garbled(a, masks, 5)
    assert psnr(a, other, masks)[0] == float("inf")
    assert ssim(a, other, masks)[0] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_a_mask_that_leaves_nothing_is_an_error(metric, masks):
    masks[1] = False
    with pytest.raises(InvalidValueError, match="leaves nothing"):
        metric(*pictures(), masks)


def test_lpips_of_blackened_pictures_knows_nothing_of_the_outside(tmp_path):
    lpips = load_lpips(*write_weights(tmp_path, "alex"), "alex")
    a, b = pictures(64, 70)
    masks = np.zeros((2, 64, 70), np.bool_)
    masks[:, 10:50, 5:40] = True
    inside = lpips(black_outside(a, masks), black_outside(b, masks))
    again = lpips(black_outside(garbled(a, masks, 5), masks), black_outside(garbled(b, masks, 6), masks))
    assert np.array_equal(inside, again)
    assert 0 < inside[0] < lpips(a, b)[0]
