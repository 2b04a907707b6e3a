import math

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from random_numbers import Numbers
from splatwire.metrics import ssim
from splatwire.metrics.ssim import ssim_map


def pair(height: int = 40, width: int = 50, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    generator = Numbers(0)
    y, x = np.meshgrid(np.linspace(0, 6, height), np.linspace(0, 9, width), indexing="ij")
    smooth = 0.5 + 0.4 * np.sin(x[..., None] + np.arange(3)) * np.cos(y[..., None])
    rough = (smooth + noise * generator.randn(height, width, 3)).clip(0, 1)
    return smooth[None], rough[None]


def test_ssim_interior_equals_scikit_image() -> None:
    a, b = pair()
    _, expected = structural_similarity(
        a[0].astype(np.float64),
        b[0].astype(np.float64),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1,
        channel_axis=2,
        full=True,
    )
    assert np.abs(ssim_map(a, b)[0] - expected)[5:-5, 5:-5].max() < 1e-4


def test_ssim_pads_with_zeros() -> None:
    """Explicit window sums of one corner pixel."""
    a, b = (t[0, ..., 0].astype(np.float64) for t in pair())
    window = [math.exp(-((k - 5) ** 2) / (2 * 1.5**2)) for k in range(11)]
    row, column = 1, 2

    def mean(values: np.ndarray) -> float:
        total = 0.0
        for i in range(11):
            for j in range(11):
                r, c = row + i - 5, column + j - 5
                if 0 <= r < values.shape[0] and 0 <= c < values.shape[1]:
                    total += window[i] * window[j] * values[r, c]
        return total / sum(window) ** 2

    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    expected = (2 * ma * mb + c1) * (2 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
    assert ssim_map(*pair())[0, row, column, 0].item() == pytest.approx(expected, abs=1e-5)


def test_ssim_is_one_for_equal_pictures_and_falls_with_noise() -> None:
    a, _ = pair()
    assert ssim(a, a).item() == pytest.approx(1.0, abs=1e-6)
    values = [ssim(*pair(noise=n)).item() for n in (0.0, 0.02, 0.05, 0.1, 0.3)]
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0.5


def test_views_are_scored_separately() -> None:
    (a, b), (c, d) = pair(), pair(noise=0.3)
    both = ssim(np.concatenate([a, c]), np.concatenate([b, d]))
    assert both.tolist() == pytest.approx([ssim(a, b).item(), ssim(c, d).item()], abs=1e-6)
