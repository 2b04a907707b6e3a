import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from close import assert_close
from splatwire.data import open_dataset
from splatwire.errors import DatasetError, InvalidValueError, UnknownNameError

DATA = Path(os.environ.get("SPLATWIRE_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


@pytest.fixture
def scene(capture):
    capture.write_images()
    capture.write_binary()
    return capture


def test_every_eighth_by_sorted_name_is_test(scene):
    assert open_dataset(scene.root).cameras.names == ("view_00", "view_08")
    train = open_dataset(scene.root, split="train").cameras.names
    assert train == tuple(f"view_{i:02d}" for i in range(12) if i % 8)
    assert open_dataset(scene.root, split="all").num_views == 12


def test_the_first_31_can_be_test(scene):
    assert open_dataset(scene.root, test_views="first_31").num_views == 12
    with pytest.raises(DatasetError, match="no views in the split 'train'"):
        open_dataset(scene.root, split="train", test_views="first_31")


def test_cameras_and_photos_belong_together(scene):
    dataset = open_dataset(scene.root, split="all")
    assert (dataset.cameras.width, dataset.cameras.height) == (40, 24)
    for view, i in enumerate(scene.sorted_views):
        np.testing.assert_allclose(dataset.cameras.viewmats[view], scene.viewmat(i), atol=1e-6)
        assert np.array_equal(dataset.image(view), scene.pixels[i].astype(np.float32) / 255)
    assert dataset.points.num_points == 5
    picked = dataset.select([4, 1])
    assert picked.cameras.names == ("view_04", "view_01")
    assert np.array_equal(picked.image(1), dataset.image(1))


def test_text_reconstructions_open_alike(scene, tmp_path):
    binary = open_dataset(scene.root, split="all").cameras
    for file in (scene.root / "sparse" / "0").glob("*.bin"):
        file.unlink()
    scene.write_text()
    text = open_dataset(scene.root, split="all").cameras
    assert np.array_equal(text.viewmats, binary.viewmats)
    assert np.array_equal(text.Ks, binary.Ks)


def test_smaller_photos_scale_the_intrinsics(scene):
    scene.write_images("images_4", (10, 6))
    dataset = open_dataset(scene.root, images="images_4")
    assert (dataset.cameras.width, dataset.cameras.height) == (10, 6)
    assert_close(dataset.cameras.Ks[0], np.array([[8.25, 0, 5], [0, 8.75, 3], [0, 0, 1]], np.float32))
    assert dataset.image(0).shape == (6, 10, 3)


def test_wide_photos_are_reduced(scene):
    dataset = open_dataset(scene.root, max_width=30)
    assert (dataset.cameras.width, dataset.cameras.height) == (30, 18)
    assert_close(dataset.cameras.Ks[0], np.array([[24.75, 0, 15], [0, 26.25, 9], [0, 0, 1]], np.float32))
    assert dataset.image(0).shape == (18, 30, 3)


def test_names_in_folders_and_other_suffixes_are_found(scene):
    for name in scene.names:
        Image.open(scene.root / "images" / name).save(scene.root / "images" / name.replace("png", "JPG"), "JPEG")
        (scene.root / "images" / name).unlink()
    paths = open_dataset(scene.root, split="all").image_paths
    assert [path.name for path in paths] == [f"view_{i:02d}.JPG" for i in range(12)]


def test_blender_splits_are_the_files(capture):
    capture.write_blender()
    test = open_dataset(capture.root, background=(1.0, 1.0, 1.0))
    assert test.cameras.names == ("r_8", "r_9", "r_10", "r_11")
    assert test.points is None
    alpha = 51 * (8 % 6) / 255
    expected = capture.pixels[8] / 255 * alpha + 1 - alpha
    np.testing.assert_allclose(test.image(0), expected, atol=1e-6)
    assert open_dataset(capture.root, split="train").num_views == 8
    assert open_dataset(capture.root, split="all").num_views == 12


def test_views_of_the_same_name_keep_their_folder(capture):
    capture.write_blender()
    for half in ("train", "test"):
        path = capture.root / f"transforms_{half}.json"
        path.write_text(path.read_text().replace("/r_8", "/r_0"))
    (capture.root / "test" / "r_8.png").rename(capture.root / "test" / "r_0.png")
    names = open_dataset(capture.root, split="all").cameras.names
    assert {"train_r_0", "test_r_0"} <= set(names)
    assert len(set(names)) == 12


def test_nerfstudio_is_split_by_sorted_name(capture):
    capture.write_nerfstudio()
    dataset = open_dataset(capture.root)
    assert dataset.cameras.names == ("view_00", "view_08")
    np.testing.assert_allclose(dataset.cameras.viewmats[0], capture.viewmat(1), atol=1e-6)
    assert dataset.cameras.Ks[0, 0, 2] == 19.5


def test_wrong_folders_are_refused(tmp_path, scene):
    with pytest.raises(DatasetError, match="no such file or folder"):
        open_dataset(tmp_path / "absent")
    with pytest.raises(DatasetError, match=r"not a dataset.*transforms_train\.json"):
        open_dataset(tmp_path)
    with pytest.raises(DatasetError, match="images_2: the image folder is missing"):
        open_dataset(scene.root, images="images_2")
    (scene.root / "images" / "view_08.png").unlink()
    with pytest.raises(DatasetError, match=r"images: 1 of 2 posed images are missing, first 'view_08\.png'"):
        open_dataset(scene.root)


def test_a_missing_half_is_named(capture):
    capture.write_blender()
    (capture.root / "transforms_test.json").unlink()
    with pytest.raises(DatasetError, match=r"transforms_test\.json: no such file"):
        open_dataset(capture.root)


def test_photos_that_do_not_fit_their_cameras_are_refused(scene):
    path = scene.root / "images" / "view_08.png"
    Image.new("RGB", (20, 12)).save(path)
    with pytest.raises(DatasetError, match=r"view_08\.png: is 20 x 12 pixels, view_00\.png 40 x 24"):
        open_dataset(scene.root)
    scene.write_images(size=(24, 40))
    with pytest.raises(DatasetError, match=r"view_00\.png: is 24 x 40 pixels, which is not the shape"):
        open_dataset(scene.root)
    path.with_name("view_00.png").write_text("no picture")
    with pytest.raises(DatasetError, match=r"view_00\.png: not a readable image"):
        open_dataset(scene.root)


def test_an_image_name_that_leaves_the_folder_is_refused(scene):
    scene.names[3] = "../../secret.png"
    scene.write_binary()
    with pytest.raises(DatasetError, match="does not stay inside"):
        open_dataset(scene.root, split="all")


@pytest.mark.parametrize("options", [{"split": "val"}, {"test_views": "last"}])
def test_unknown_splits_are_refused(scene, options):
    with pytest.raises(UnknownNameError, match=next(iter(options.values()))):
        open_dataset(scene.root, **options)


def test_a_width_limit_must_be_positive(scene):
    with pytest.raises(InvalidValueError, match="max_width"):
        open_dataset(scene.root, max_width=0)


@pytest.mark.data
def test_real_layouts_open():
    if not (DATA / "scenes").is_dir():
        pytest.skip(f"no photos under {DATA / 'scenes'} (set SPLATWIRE_DATA)")
    sizes = {
        "bonsai_small": (73, 400, 266),
        "llff_flower_small": (34, 400, 283),
        "nerf_synthetic_lego_small": (125, 200, 200),
    }
    for name, (count, width, height) in sizes.items():
        dataset = open_dataset(DATA / "scenes" / name, split="all")
        assert (dataset.num_views, dataset.cameras.width, dataset.cameras.height) == (count, width, height)
        assert dataset.image(0).shape == (height, width, 3)
    assert open_dataset(DATA / "scenes" / "bonsai_small").points.num_points == 44_278


@pytest.mark.data
def test_real_blender_cameras_look_at_the_object():
    if not (DATA / "scenes").is_dir():
        pytest.skip(f"no photos under {DATA / 'scenes'} (set SPLATWIRE_DATA)")
    cameras = open_dataset(DATA / "scenes" / "nerf_synthetic_lego_small").cameras
    depth = cameras.viewmats[:, 2, 3]  # of the world's origin
    assert (depth > 3.5).all()
    assert (depth < 4.5).all()
    assert (np.abs(cameras.viewmats[:, :2, 3]) < 0.2).all()
