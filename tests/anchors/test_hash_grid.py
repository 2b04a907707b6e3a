import itertools
import math

import pytest
import torch

from reference.float_prior import interpolate_hash_grid, interpolate_tables
from splatwire.neural.model.hash_grid import corner_rows
from splatwire.neural.model.tensors import to_tensors
from splatwire.types.anchor_config import HashGridConfig

CONFIG = HashGridConfig(2, (6, 11, 20), (9, 33), 8, 9)


def plain_lookup(table, start: int, rows: int, resolution: int, u: list[float]) -> list[float]:
    """One level at one position in plain Python, following the description of the grid."""
    width = table.shape[1]
    if any(not 0 <= c <= 1 for c in u):
        return [0.0] * width
    place = [c * (resolution - 2) + 0.5 for c in u]
    cell = [math.floor(p) for p in place]
    total, weight_sum = [0.0] * width, 0.0
    for corner in itertools.product((0, 1), repeat=len(u)):
        at = [c + d for c, d in zip(cell, corner, strict=True)]
        if any(a == 0 or a == resolution - 1 for a in at):
            continue
        weight = math.prod(p - c if d else 1 - (p - c) for p, c, d in zip(place, cell, corner, strict=True))
        if resolution ** len(u) <= rows:
            row = sum(a * resolution**i for i, a in enumerate(at))
        else:
            row = 0
            for a, prime in zip(at, (1, 2654435761, 805459861), strict=False):
                row ^= a * prime % 2**32
        weight_sum += weight
        for f in range(width):
            total[f] += weight * float(table[start + row % rows, f])
    return [t / max(weight_sum, 1e-9) for t in total]


def test_vectorised_lookup_equals_the_reference(tiny_scene):
    grid = to_tensors(tiny_scene.coding.context_model.grid)
    g = torch.Generator().manual_seed(1)
    positions = torch.rand(60, 3, generator=g) * 6 - 2.3  # some outside the box
    positions[0], positions[1] = grid.bounds_min, grid.bounds_max
    ours = interpolate_hash_grid(grid, positions, CONFIG)
    assert ours.shape == (60, CONFIG.context_dim)
    unit = (positions - grid.bounds_min) / (grid.bounds_max - grid.bounds_min)
    for i, row in enumerate(ours.tolist()):
        expected = []
        for table, axes, resolutions, rows in (
            (grid.volume, (0, 1, 2), CONFIG.resolutions_3d, CONFIG.rows(3)),
            (grid.planes[0], (0, 1), CONFIG.resolutions_2d, CONFIG.rows(2)),
            (grid.planes[1], (0, 2), CONFIG.resolutions_2d, CONFIG.rows(2)),
            (grid.planes[2], (1, 2), CONFIG.resolutions_2d, CONFIG.rows(2)),
        ):
            u = [unit[i, a].item() for a in axes]
            for level, resolution in enumerate(resolutions):
                expected += plain_lookup(table, sum(rows[:level]), rows[level], resolution, u)
        assert row == pytest.approx(expected, abs=2e-5)


def test_the_tiny_config_has_dense_and_hashed_levels():
    assert CONFIG.rows(3) == (216, 256, 256)
    assert CONFIG.rows(2) == (88, 512)


@pytest.mark.parametrize(("resolution", "rows", "dims"), [(6, 216, 3), (20, 256, 3), (514, 8192, 3), (1026, 32768, 2)])
def test_weights_sum_to_one_inside_and_rows_stay_in_the_level(resolution, rows, dims):
    unit = torch.rand(500, dims, generator=torch.Generator().manual_seed(2))
    index, weights = corner_rows(unit, resolution, rows)
    assert index.shape == weights.shape == (500, 2**dims)
    assert index.min() >= 0
    assert index.max() < rows
    torch.testing.assert_close(weights.sum(dim=1), torch.ones(500))
    _, outside = corner_rows(unit + 1.5, resolution, rows)
    assert not outside.any()


def test_lookup_does_not_depend_on_the_chunk_size(tiny_scene):
    positions = torch.rand(32768 + 5, 3, generator=torch.Generator().manual_seed(3))
    grid = to_tensors(tiny_scene.coding.context_model.grid)
    whole = interpolate_hash_grid(grid, positions, CONFIG)
    assert torch.equal(whole[-5:], interpolate_hash_grid(grid, positions[-5:], CONFIG))


def test_gradients_reach_exactly_the_rows_that_were_read():
    volume = torch.zeros(sum(CONFIG.rows(3)), 2, requires_grad=True)
    planes = torch.zeros(3, sum(CONFIG.rows(2)), 2, requires_grad=True)
    unit = torch.tensor([[0.31, 0.62, 0.17]])
    interpolate_tables(volume, planes, unit, CONFIG).sum().backward()
    start = CONFIG.rows(3)[0]
    index, weights = corner_rows(unit, 11, 256)
    expected = torch.zeros(256).index_add(0, index[0], weights[0])
    torch.testing.assert_close(volume.grad[start : start + 256, 0], expected)
    assert planes.grad.abs().sum() == pytest.approx(3 * 2 * 2, rel=1e-5)
