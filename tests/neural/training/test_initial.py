import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
import torch

from scenes import VOXEL_SIZE
from splat_io.formats.handmade import some_splats
from splat_io.formats.test_origin import UTM, geo_ply
from splatwire.data import Dataset, SparsePoints
from splatwire.errors import DatasetError
from splatwire.io import open_scene
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.initial import camera_extent, grid_bounds, initial_state, parameter_shapes, points_of
from splatwire.types import Cameras


def _with_points(dataset: Dataset, points: np.ndarray | None) -> Dataset:
    sparse = None if points is None else SparsePoints(points, np.zeros_like(points))
    return dataclasses.replace(dataset, points=sparse)


def test_anchors_start_at_the_points(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)
    assert dataset.points is not None
    expected = {tuple(p) for p in np.rint(dataset.points.positions / VOXEL_SIZE).astype(np.int64).tolist()}
    assert {tuple(v) for v in state.voxels.tolist()} == expected
    distances = torch.cdist(state.positions, state.positions).topk(4, largest=False).values[:, 1:]
    sizes = state.parameters["log_scalings"].detach().exp()[:, 0]
    torch.testing.assert_close(sizes, distances.square().mean(dim=1).sqrt(), atol=1e-4, rtol=1e-4)
    shapes = parameter_shapes(config, state.num_anchors)
    assert {name: tuple(value.shape) for name, value in state.parameters.items()} == shapes
    assert all(value.requires_grad for value in state.parameters.values())


def test_points_in_one_voxel_become_one_anchor(dataset: Dataset, config: TrainConfig) -> None:
    points = np.float32([[0.0, 0, 0], [VOXEL_SIZE / 4, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]])
    assert initial_state(_with_points(dataset, points), config).num_anchors == 4


def test_missing_points_fill_the_bounding_box(dataset: Dataset, config: TrainConfig) -> None:
    config = dataclasses.replace(config, random_points=500)
    positions = initial_state(_with_points(dataset, None), config).positions
    half = 1.3 / 4.03 * 3.03
    assert 400 < len(positions) <= 500
    assert bool((positions.abs() < half + 0.5).all())
    assert float(positions.std()) == pytest.approx(half / 3**0.5, rel=0.2)


def test_voxel_size_is_derived_from_the_points(dataset: Dataset, config: TrainConfig) -> None:
    grid = np.float32(list(itertools.product(np.arange(5.0) / 5, repeat=3)))
    state = initial_state(_with_points(dataset, grid), dataclasses.replace(config, voxel_size=0.0))
    assert state.voxel_size == pytest.approx(0.04, rel=1e-4)  # every point has three neighbours at 0.2


def test_bounds_have_a_margin_and_positive_extent() -> None:
    low, high = grid_bounds(torch.tensor([[1.0, -2, 3], [2.0, 4, 3]]))
    torch.testing.assert_close(low, torch.tensor([0.8, -2.4, 2.4]))
    torch.testing.assert_close(high, torch.tensor([2.4, 4.8, 3.6]))
    low, high = grid_bounds(torch.zeros(3, 3))
    assert bool((high > low).all())


def test_camera_extent_is_the_padded_radius(dataset: Dataset) -> None:
    assert camera_extent(dataset.cameras) == pytest.approx(1.1 * 3.0, rel=1e-3)


def test_untrainable_data_is_refused_at_once(dataset: Dataset, config: TrainConfig) -> None:
    cameras = dataset.cameras

    def moved(viewmats: np.ndarray) -> Dataset:
        changed = Cameras(viewmats, cameras.Ks, cameras.width, cameras.height, cameras.names)
        return dataclasses.replace(dataset, cameras=changed)

    turned = cameras.viewmats.copy()
    turned[:, [0, 2]] *= -1  # directed away from the scene
    cases = {
        "at least 2 views": dataset.select([3]),
        "same place": moved(cameras.viewmats[:1].repeat(8, axis=0)),
        "see none of the points": moved(turned),
        "usable points": _with_points(dataset, np.full((3, 3), 0.1, np.float32)),
        "larger voxel size": _with_points(dataset, np.full((9, 3), 1e6, np.float32)),
    }
    for message, broken in cases.items():
        with pytest.raises(DatasetError, match=message):
            initial_state(broken, config)


def test_points_of_a_world_scene_keep_its_origin(tmp_path: Path) -> None:
    splats = some_splats(400, 1)
    geo_ply(splats, np.array(UTM), tmp_path / "world.ply")
    points = points_of(open_scene(tmp_path / "world.ply"))
    assert np.abs(np.array(points.origin) - UTM).max() < 2
    relative = points.relative_to(UTM).positions
    assert np.abs(relative - splats.means[splats.opacities > 1 / 255]).max() < 1e-4


def test_anchors_start_relative_to_the_origin_of_the_cameras(dataset: Dataset, config: TrainConfig) -> None:
    assert dataset.points is not None
    cameras = dataclasses.replace(dataset.cameras, origin=UTM)
    points = dataclasses.replace(dataset.points, origin=UTM).relative_to((UTM[0] - 16, UTM[1] + 8, UTM[2]))
    state = initial_state(dataclasses.replace(dataset, cameras=cameras, points=points), config)
    local = initial_state(dataset, config)
    assert state.origin == UTM
    assert torch.equal(state.voxels, local.voxels)
    assert all(torch.equal(state.parameters[name], value) for name, value in local.parameters.items())
