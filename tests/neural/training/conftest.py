"""A tiny dataset: renders of a synthetic scene as image files."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenes import SMALL_CONFIG, VOXEL_SIZE, tiny_cameras, tiny_scene
from splatwire.data import Dataset, SparsePoints
from splatwire.neural.training.config import LossWeights, Milestones, RefineConfig, TrainConfig
from splatwire.render.render import render_scene

NUM_VIEWS = 8


def photographed(folder: Path, width: int, height: int) -> Dataset:
    """Photos of a scene of 200 anchors, and its anchors as sparse points."""
    scene, cameras = tiny_scene(num_anchors=200), tiny_cameras(NUM_VIEWS, width, height)
    paths = []
    for name, image in zip(cameras.names, render_scene(scene, cameras), strict=True):
        path: Path = folder / f"{name}.png"
        Image.fromarray((image * 255).round().astype(np.uint8)).save(path)
        paths.append(path)
    points = SparsePoints(scene.anchors.positions, np.random.default_rng(0).random((200, 3), np.float32))
    return Dataset(cameras, tuple(paths), points)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Photos of 48 x 32 pixels and sparse points."""
    return photographed(tmp_path_factory.mktemp("photos"), 48, 32)


@pytest.fixture(scope="session")
def config() -> TrainConfig:
    """A configuration with small networks and all phases within 60 iterations."""
    marks = Milestones(
        iterations=60, noise_start=20, growth_pause_end=24, context_start=36, statistics_start=2, growth_start=4,
        growth_end=50, growth_interval=6,
    )  # fmt: skip
    weights = LossWeights(sample_share=0.3)
    recipe = TrainConfig(
        model=SMALL_CONFIG, voxel_size=VOXEL_SIZE, hidden=(16, 16, 8), milestones=marks, weights=weights,
        refine=RefineConfig(steps=5),
    )  # fmt: skip
    return dataclasses.replace(recipe, growth=dataclasses.replace(recipe.growth, gradient_threshold=1e-5))


@pytest.fixture
def folder(dataset: Dataset, tmp_path: Path) -> Path:
    """The dataset in nerfstudio's layout, without points."""
    root = tmp_path / "scene"
    (root / "images").mkdir(parents=True)
    frames = []
    for view, path in enumerate(dataset.image_paths):
        shutil.copy(path, root / "images" / path.name)
        pose = np.linalg.inv(dataset.cameras.viewmats[view]) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/{path.name}", "transform_matrix": pose.tolist()})
    K = dataset.cameras.Ks[0]
    content = {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), "w": 48, "h": 32, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))
    return root
