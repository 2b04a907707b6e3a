import pytest
import torch

from reference.float_prior import interpolate_tables
from scenes import SMALL_CONFIG
from splatwire.neural.training.grid import (
    GridCorners,
    find_corners,
    hard_sign,
    interpolate_signs,
    sign_bits,
    straight_through_sign,
)
from splatwire.types import HashGridConfig


def _interpolate_autograd(tables: torch.Tensor, corners: GridCorners, index: torch.Tensor) -> torch.Tensor:
    """Signs at some positions, tables one after another, with the gradient of autograd."""
    signs, parts = straight_through_sign(tables), []
    for rows, weights in (
        (corners.volume_rows[:, index], corners.volume_weights[:, index]),
        (corners.plane_rows[:, index], corners.plane_weights[:, index]),
    ):
        parts.append((signs[rows.long()] * weights[..., None]).sum(dim=2).transpose(0, 1).flatten(1))
    return torch.cat(parts, dim=1)


GRIDS = [SMALL_CONFIG.grid, HashGridConfig(3, (6, 9), (12, 40), 7, 7)]


def _tables(grid: HashGridConfig, spread: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(0)
    depth = grid.features_per_level
    volume = spread * torch.randn(sum(grid.rows(3)), depth, generator=rng)
    planes = spread * torch.randn(3, sum(grid.rows(2)), depth, generator=rng)
    return volume, planes, 1.2 * torch.rand(300, 3, generator=rng) - 0.1  # some outside of the box


@pytest.mark.parametrize("grid", GRIDS)
def test_grid_lookup_equals_the_model(grid: HashGridConfig) -> None:
    volume, planes, unit = _tables(grid)
    index = torch.tensor([5, 5, 250, 17])
    own = interpolate_signs(volume, planes, find_corners(unit, grid), index)
    expected = interpolate_tables(hard_sign(volume), hard_sign(planes), unit[index], grid)
    torch.testing.assert_close(own, expected)


@pytest.mark.parametrize("grid", GRIDS)
def test_grid_gradient_equals_the_plain_version(grid: HashGridConfig) -> None:
    volume, planes, unit = _tables(grid)
    corners, index = find_corners(unit, grid), torch.arange(300).flip(0)[:280]
    weight = torch.randn(280, grid.context_dim, generator=torch.Generator().manual_seed(1))
    own = [volume.clone().requires_grad_(), planes.clone().requires_grad_()]
    (interpolate_signs(own[0], own[1], corners, index) * weight).sum().backward()
    tables = torch.cat([volume, planes.flatten(0, 1)]).requires_grad_()
    (_interpolate_autograd(tables, corners, index) * weight).sum().backward()
    assert own[0].grad is not None
    assert own[1].grad is not None
    assert tables.grad is not None
    torch.testing.assert_close(torch.cat([own[0].grad, own[1].grad.flatten(0, 1)]), tables.grad, atol=1e-5, rtol=1e-4)


def test_sign_passes_gradients_in_the_unit_interval() -> None:
    values = torch.tensor([-2.0, -1.0, -0.1, 0.0, 0.1, 1.0, 2.0], requires_grad=True)
    signs = straight_through_sign(values)
    assert signs.tolist() == [-1, -1, -1, 1, 1, 1, 1]
    signs.sum().backward()
    assert values.grad is not None
    assert values.grad.tolist() == [0, 1, 1, 1, 1, 1, 0]


def test_sign_bits_equal_their_entropy() -> None:
    even = torch.cat([torch.full((8, 4), 0.5), torch.full((8, 4), -0.5)])
    planes = even.expand(3, 16, 4).clone()
    assert float(sign_bits(even, planes)) == pytest.approx(4 * 64 + 32)
    assert float(sign_bits(even.abs(), planes.abs())) == pytest.approx(32, abs=0.1)
    mostly = torch.where(torch.rand(64, 4, generator=torch.Generator().manual_seed(0)) < 0.9, 0.5, -0.5)
    mostly.requires_grad_()
    sign_bits(mostly, mostly.detach().expand(3, 64, 4)).backward()
    assert mostly.grad is not None
    assert bool((mostly.grad < 0).all())  # gradient descent moves all values towards the majority
