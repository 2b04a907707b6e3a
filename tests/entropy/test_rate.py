import numpy as np
import pytest
import torch

from splatwire.entropy.coder import Mixtures, encode_symbols
from splatwire.entropy.tables import MEAN_BITS, SCALE_MIN_EXPONENT, SCALE_STEPS
from splatwire.neural.training.rate import binary_entropy_bits, bits, gaussian_likelihood, mixture_likelihood

COUNT = 20_000


def _scale_index(scale: torch.Tensor) -> np.ndarray:
    mantissa, exponent = np.frexp(scale.numpy().astype(np.float64))  # scale = mantissa * 2**exponent, mantissa >= 0.5
    step = np.floor((2 * mantissa - 1) * SCALE_STEPS)
    return ((exponent - 1 - SCALE_MIN_EXPONENT) * SCALE_STEPS + step).astype(np.int64)


def _mean_code(mean: torch.Tensor) -> np.ndarray:
    return np.rint(mean.numpy().astype(np.float64) * (1 << MEAN_BITS)).astype(np.int64)


def _normals(seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(seed)
    mean = 4 * torch.randn(COUNT, 1, generator=rng)
    scale = torch.exp2(5 * torch.rand(COUNT, 1, generator=rng) - 2)
    return mean, scale, mean + scale * torch.randn(COUNT, 1, generator=rng)


def test_normal_rate_equals_coded_bits() -> None:
    mean, scale, values = _normals(0)
    symbols = torch.round(values)
    estimate = float(bits(gaussian_likelihood(symbols, mean, scale, torch.ones(COUNT, 1))).sum()) / 8
    mixtures = Mixtures.normals(_mean_code(mean)[:, 0], _scale_index(scale)[:, 0])
    real = len(encode_symbols(symbols[:, 0].numpy().astype(np.int64), mixtures))
    assert estimate == pytest.approx(real, rel=0.01)


def test_mixture_rate_equals_coded_bits() -> None:
    mean, scale, first = _normals(1)
    other_mean, other_scale, second = _normals(2)
    logit = torch.round(2 * torch.randn(COUNT, 1, generator=torch.Generator().manual_seed(3)) * 16) / 16
    weight = torch.sigmoid(logit)
    luck = torch.rand(COUNT, 1, generator=torch.Generator().manual_seed(4))
    symbols, step = torch.round(torch.where(luck < weight, first, second)), torch.ones(COUNT, 1)
    likelihoods = [gaussian_likelihood(symbols, *p, step) for p in ((mean, scale), (other_mean, other_scale))]
    estimate = float(bits(mixture_likelihood(likelihoods[0], likelihoods[1], logit)).sum()) / 8
    codes = [_mean_code(mean), _scale_index(scale), _mean_code(other_mean), _scale_index(other_scale)]
    mixtures = Mixtures(*(c[:, 0] for c in codes), np.rint(weight[:, 0].numpy() * 65536).astype(np.int64))
    real = len(encode_symbols(symbols[:, 0].numpy().astype(np.int64), mixtures))
    assert estimate == pytest.approx(real, rel=0.01)


def test_uniform_noise_approximates_rounding() -> None:
    rng = torch.Generator().manual_seed(5)
    mean, scale, values = _normals(6)
    step = torch.full((COUNT, 1), 0.7)
    rounded = bits(gaussian_likelihood(torch.round(values / step) * step, mean, scale, step)).mean()
    noise = (torch.rand(values.shape, generator=rng) - 0.5) * step
    noisy = bits(gaussian_likelihood(values + noise, mean, scale, step)).mean()
    assert float(noisy) == pytest.approx(float(rounded), rel=0.03)


def test_rate_gradient_equals_finite_differences() -> None:
    rng = torch.Generator().manual_seed(7)
    values, mean, step = (torch.rand(6, 2, generator=rng, dtype=torch.float64) for _ in range(3))
    scale, step = 0.2 + torch.rand(6, 2, generator=rng, dtype=torch.float64), step[:, :1] + 0.1
    inputs = [t.requires_grad_() for t in (values, mean, scale, step)]
    assert torch.autograd.gradcheck(lambda *x: bits(gaussian_likelihood(*x)), inputs)


def test_impossible_symbols_cost_twenty_bits_without_gradient() -> None:
    mean = torch.zeros(1, 1, requires_grad=True)
    cost = bits(gaussian_likelihood(torch.full((1, 1), 50.0), mean, torch.ones(1, 1), torch.ones(1, 1)))
    cost.sum().backward()
    assert float(cost.detach()) == pytest.approx(19.93, abs=0.01)
    assert mean.grad is not None
    assert float(mean.grad) == 0


def test_binary_entropy_equals_its_definition() -> None:
    assert binary_entropy_bits(50.0, 100) == pytest.approx(100)
    assert binary_entropy_bits(0.0, 100) == pytest.approx(0, abs=1e-5)
    assert binary_entropy_bits(11.0, 100) == pytest.approx(49.99, abs=0.01)
