"""Masks of photos in training, and the background of the exported scene."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatwire.data import Dataset
from splatwire.errors import DatasetError
from splatwire.metrics import psnr, ssim
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.quality import assess_scene
from splatwire.render.render import render_scene

pytestmark = pytest.mark.slow


def _masked(dataset: Dataset, folder: Path, left: int) -> Dataset:
    """The dataset with masks of the leftmost columns."""
    mask = np.zeros((dataset.cameras.height, dataset.cameras.width), np.uint8)
    mask[:, :left] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    return dataclasses.replace(dataset, mask_paths=(folder / "mask.png", *[None] * (dataset.num_views - 1)))


def test_photos_keep_their_masks(dataset: Dataset, tmp_path: Path) -> None:
    store = PhotoStore(_masked(dataset, tmp_path, 20), torch.device("cpu"))
    mask = store.photo(0).mask
    assert mask is not None
    assert int(mask.sum()) == 20 * dataset.cameras.height
    assert store.photo(1).mask is None


def test_empty_mask_is_refused_before_the_first_iteration(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=f"{dataset.cameras.names[0]}.*leaves nothing"):
        PhotoStore(_masked(dataset, tmp_path, 0), torch.device("cpu"))


def test_quality_counts_only_unmasked_pixels(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> None:
    scene = export_scene(initial_state(dataset, config), config)
    only = dataset.select([0])
    picture = render_scene(scene, only.cameras)[:, :, :20]
    photo = only.image(0)[None, :, :20]
    report = assess_scene(scene, _masked(only, tmp_path, 20), 1, 0)
    assert report.psnr == pytest.approx(float(psnr(picture, photo)[0]), abs=1e-3)
    assert report.ssim == pytest.approx(float(ssim(picture, photo)[0]), abs=1e-5)


def test_exported_scene_keeps_its_background(dataset: Dataset, config: TrainConfig) -> None:
    white = dataclasses.replace(config, background=(1.0, 1.0, 1.0))
    assert export_scene(initial_state(dataset, white), white).background == (1.0, 1.0, 1.0)
