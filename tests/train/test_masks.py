"""Masks of photos in training, and the background that a scene takes along."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatwire.data import Dataset
from splatwire.errors import DatasetError
from splatwire.metrics import psnr, ssim
from splatwire.render.render import render_scene
from splatwire.train.config import TrainConfig
from splatwire.train.export import export_scene
from splatwire.train.initial import initial_state
from splatwire.train.photos import PhotoStore
from splatwire.train.quality import assess_scene


def _masked(dataset: Dataset, folder: Path, left: int) -> Dataset:
    """The dataset with masks that leave so many columns on the left."""
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


def test_a_mask_that_leaves_nothing_is_told_before_the_first_iteration(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=f"{dataset.cameras.names[0]}.*leaves nothing"):
        PhotoStore(_masked(dataset, tmp_path, 0), torch.device("cpu"))


def test_quality_is_that_of_what_counts(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> None:
    scene = export_scene(initial_state(dataset, config), config)
    only = dataset.select([0])
    picture = render_scene(scene, only.cameras)[:, :, :20]
    photo = only.image(0)[None, :, :20]
    report = assess_scene(scene, _masked(only, tmp_path, 20), 1, 0)
    assert report.psnr == pytest.approx(float(psnr(picture, photo)[0]), abs=1e-3)
    assert report.ssim == pytest.approx(float(ssim(picture, photo)[0]), abs=1e-5)


def test_the_scene_takes_its_background_along(dataset: Dataset, config: TrainConfig) -> None:
    white = dataclasses.replace(config, background=(1.0, 1.0, 1.0))
    assert export_scene(initial_state(dataset, white), white).background == (1.0, 1.0, 1.0)
