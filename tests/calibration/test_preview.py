"""A fitted preview is closer to the scene than the background alone."""

import dataclasses

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.calibration.preview import PreviewConfig, preview_for_scene
from splatwire.calibration.views import CalibrationViews
from splatwire.codec.preview import gaussians_within, preview_gaussians, read_preview
from splatwire.errors import InvalidValueError
from splatwire.render import iterate_views
from splatwire.types import AnchorScene, Cameras

pytestmark = pytest.mark.slow

QUICK = PreviewConfig(num_bytes=400, steps=160, num_relocations=4, width=48, views=8)


@pytest.fixture(scope="module")
def scene() -> AnchorScene:
    return tiny_scene(seed=3)


@pytest.fixture(scope="module")
def cameras() -> Cameras:
    return tiny_cameras(num_views=8, width=48, height=32)


def test_preview_is_closer_to_the_views_than_the_background(scene: AnchorScene, cameras: Cameras) -> None:
    shares: list[float] = []
    result = preview_for_scene(scene, CalibrationViews(cameras), QUICK, progress=lambda _, share: shares.append(share))
    assert result.psnr["preview"] > result.psnr["background"] + 3
    assert result.psnr["complete"] == 100.0
    assert len(result.section) <= QUICK.num_bytes
    assert read_preview(result.section).num_gaussians == result.num_gaussians == gaussians_within(400)
    assert shares[-1] == 1.0
    assert preview_for_scene(scene, CalibrationViews(cameras), QUICK).section == result.section


def test_preview_follows_photos_inside_their_masks(scene: AnchorScene, cameras: Cameras) -> None:
    """Red photos with a mask that hides their green left half."""
    photo = np.zeros((32, 48, 3), np.float32)
    photo[:, :24, 1] = photo[:, 24:, 0] = 1.0
    mask = np.zeros((32, 48), np.bool_)
    mask[:, 24:] = True
    views = CalibrationViews(cameras, lambda view: photo, (0.5, 0.5, 0.5), lambda view: mask)
    config = dataclasses.replace(QUICK, steps=120)
    result = preview_for_scene(scene, views, config)
    assert result.psnr["preview"] > 15
    assert bool((preview_gaussians(result.section)[0].colors.mean(axis=0).argmax() == 0).all())


def test_test_views_do_not_change_the_preview(scene: AnchorScene, cameras: Cameras) -> None:
    config = dataclasses.replace(QUICK, steps=30)
    pictures = list(iterate_views(scene, cameras))
    views = CalibrationViews(cameras, pictures.__getitem__)
    alone = preview_for_scene(scene, views, config)
    judged = preview_for_scene(
        scene, views, config, test=CalibrationViews(cameras.select([1]), lambda view: pictures[1])
    )
    assert judged.section == alone.section
    assert judged.psnr != alone.psnr


def test_preview_of_one_anchor_is_made(cameras: Cameras) -> None:
    result = preview_for_scene(
        tiny_scene(num_anchors=1), CalibrationViews(cameras), dataclasses.replace(QUICK, steps=5, num_relocations=1)
    )
    assert result.num_gaussians == 1


def test_invalid_arguments_are_refused(scene: AnchorScene, cameras: Cameras) -> None:
    for wrong in ({"num_bytes": 50}, {"steps": 0}, {"relocated_share": 1.0}, {"seed": -1}):
        with pytest.raises(InvalidValueError, match=next(iter(wrong))):
            PreviewConfig(**wrong)
    away = cameras.viewmats.copy()
    away[:, 2, 3] -= 100
    with pytest.raises(InvalidValueError, match="nothing to preview"):
        preview_for_scene(scene, CalibrationViews(dataclasses.replace(cameras, viewmats=away)), QUICK)
