"""The parts of an iteration in torch operations alone, against the compiled ones and their definitions."""

import pytest
import torch

from photometric_reference import photometric_loss_reference
from scenes import SMALL_CONFIG
from splatwire.neural.training.adam import adam_update
from splatwire.neural.training.grid import find_corners, interpolate_signs
from splatwire.neural.training.kernels import uniform_from_host, uniform_on_device
from splatwire.neural.training.photometric_loss import photometric_loss, prepare_photo
from splatwire.neural.training.plain import (
    adam_update_plain,
    interpolate_signs_plain,
    photometric_loss_plain,
    prepare_photo_plain,
)
from splatwire.neural.training.state import Moments


def _pictures(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(0)
    photo = torch.rand(height, width, 3, generator=rng)
    return photo + 0.1 * torch.randn(height, width, 3, generator=rng), photo


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 20), (37, 50)])
@pytest.mark.parametrize("dssim", [0.0, 0.2, 1.0])
def test_plain_loss_equals_the_compiled_one(height: int, width: int, dssim: float) -> None:
    image, photo = _pictures(height, width)
    own, theirs = image.clone().requires_grad_(), image.double().requires_grad_()
    loss, error = photometric_loss_plain(own, prepare_photo_plain(photo), dssim)
    reference, reference_error = photometric_loss_reference(theirs, photo.double(), dssim)
    (3 * loss).backward()
    (3 * reference).backward()
    torch.testing.assert_close(loss.double(), reference, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(error.double(), reference_error, atol=1e-6, rtol=1e-6)
    assert own.grad is not None
    assert theirs.grad is not None
    torch.testing.assert_close(own.grad.double(), theirs.grad, atol=1e-4 * float(theirs.grad.abs().max()), rtol=1e-3)


def test_plain_masked_loss_equals_the_compiled_one() -> None:
    image, photo = _pictures(24, 30)
    mask = torch.zeros(24, 30, dtype=torch.bool)
    mask[:, :10] = True
    own, theirs = (image.clone().requires_grad_() for _ in range(2))
    loss, _ = photometric_loss_plain(own, prepare_photo_plain(photo, mask), 0.2)
    expected, _ = photometric_loss(theirs, prepare_photo(photo, mask), 0.2)
    loss.backward()
    expected.backward()
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(own.grad, theirs.grad, atol=1e-7, rtol=1e-3)


def test_plain_photo_preparation_equals_the_compiled_one() -> None:
    _, photo = _pictures(20, 33)
    torch.testing.assert_close(prepare_photo_plain(photo).moments, prepare_photo(photo).moments, atol=1e-6, rtol=1e-5)


def test_plain_hash_grid_equals_the_compiled_one() -> None:
    grid, rng = SMALL_CONFIG.grid, torch.Generator().manual_seed(0)
    volume = torch.randn(sum(grid.rows(3)), grid.features_per_level, generator=rng)
    planes = torch.randn(3, sum(grid.rows(2)), grid.features_per_level, generator=rng)
    corners = find_corners(1.2 * torch.rand(300, 3, generator=rng) - 0.1, grid)  # some outside of the box
    index = torch.randint(300, (500,), generator=rng)
    weight = torch.randn(500, grid.context_dim, generator=rng)
    results = []
    for interpolate in (interpolate_signs, interpolate_signs_plain):
        tables = [volume.clone().requires_grad_(), planes.clone().requires_grad_()]
        features = interpolate(tables[0], tables[1], corners, index)
        (features * weight).sum().backward()
        results.append([features.detach(), *(table.grad for table in tables)])
    torch.testing.assert_close(results[0], results[1], atol=1e-5, rtol=1e-4)
    empty = interpolate_signs_plain(volume, planes, corners, index[:0])
    assert tuple(empty.shape) == (0, grid.context_dim)


def test_plain_adam_equals_the_compiled_one() -> None:
    rng = torch.Generator().manual_seed(0)
    start = torch.randn(7, 11, generator=rng)
    values = [start.clone() for _ in range(2)]
    memory = [Moments(torch.zeros_like(start), torch.zeros_like(start)) for _ in range(2)]
    for _ in range(5):
        gradient = torch.randn(start.shape, generator=rng)
        for update, value, moments in zip((adam_update, adam_update_plain), values, memory, strict=True):
            update([(value, gradient, moments, 0.01)])
    torch.testing.assert_close(values[0], values[1], atol=2e-6, rtol=1e-5)
    assert memory[0].steps == memory[1].steps == 5


@pytest.mark.parametrize("uniform", [uniform_from_host, uniform_on_device])
def test_noise_is_uniform_and_follows_the_generator(uniform: object) -> None:
    assert callable(uniform)
    draws = []
    for seed in (0, 0, 1):
        generator = torch.Generator().manual_seed(seed)
        draws.append([uniform(torch.Size([2000, 5]), generator, torch.device("cpu")) for _ in range(2)])
    first, again, other = draws
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[1], again[1])
    assert not torch.equal(first[0], first[1])
    assert not torch.equal(first[0], other[0])
    assert 0 <= float(first[0].min()) < 0.001
    assert 0.999 < float(first[0].max()) < 1
    assert float(first[0].mean()) == pytest.approx(0.5, abs=0.01)
