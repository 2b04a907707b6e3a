"""Small generated datasets in every layout of the usual benchmarks."""

import json
import math
import shutil
import struct

import numpy as np
import pytest
from PIL import Image

from close import assert_close
from data.conftest import Capture
from splatwire.data import dataset_layout, open_dataset
from splatwire.errors import DatasetError


def test_dataset_layouts_are_detected(capture, tmp_path):
    assert dataset_layout(tmp_path) is None
    capture.write_nerfstudio()
    assert dataset_layout(capture.root) == "nerfstudio"
    capture.write_blender()
    assert dataset_layout(capture.root) == "blender"
    capture.write_binary()
    assert dataset_layout(capture.root) == "colmap"
    capture.write_bungee()
    assert dataset_layout(capture.root) == "bungeenerf"


@pytest.mark.parametrize("layout", ["blender", "nerfstudio"])
def test_transforms_beside_a_reconstruction_give_a_warning_and_are_read_if_their_file_is_named(capture, caplog, layout):
    capture.write_images()
    getattr(capture, f"write_{layout}")()
    capture.write_binary()
    name = {"blender": "transforms_train.json", "nerfstudio": "transforms.json"}[layout]
    assert open_dataset(capture.root, split="all").cameras.Ks[0, 1, 1] == 35  # the vertical one of the reconstruction
    folder = capture.root / "sparse" / "0"
    assert f"the poses of the COLMAP reconstruction {folder} are read, those of transforms" in caplog.text
    assert f"name the file {capture.root / name} in place of the folder" in caplog.text
    caplog.clear()
    chosen = open_dataset(capture.root / name, split="train")
    assert dataset_layout(capture.root / name) == layout
    shutil.rmtree(capture.root / "sparse")
    alone = open_dataset(capture.root, split="train")
    assert np.array_equal(chosen.cameras.viewmats, alone.cameras.viewmats)
    assert np.array_equal(chosen.cameras.Ks, alone.cameras.Ks)
    assert chosen.image_paths == alone.image_paths
    assert chosen.points is None
    assert not caplog.messages


def test_bungeenerf_has_poses_in_the_order_of_the_photos(capture):
    capture.write_bungee()
    dataset = open_dataset(capture.root)  # the first 31 views are test views, here all 12
    assert dataset.cameras.names == tuple(f"view_{i:02d}" for i in range(12))
    assert dataset.points is None
    for view, i in enumerate(capture.sorted_views):
        np.testing.assert_allclose(dataset.cameras.viewmats[view], capture.viewmat(i), atol=1e-6)
        assert np.array_equal(dataset.image(view), capture.pixels[i].astype(np.float32) / 255)
    assert_close(dataset.cameras.Ks[0], np.array([[33.0, 0, 20], [0, 33, 12], [0, 0, 1]], np.float32))
    with pytest.raises(DatasetError, match="no views in the split 'train'"):
        open_dataset(capture.root, split="train")
    assert open_dataset(capture.root, test_views="every_8th").num_views == 2


def test_bungeenerf_photos_can_be_smaller(capture):
    capture.write_bungee()
    capture.write_images("images_4", (10, 6))
    dataset = open_dataset(capture.root, images="images_4")
    assert_close(dataset.cameras.Ks[0], np.array([[8.25, 0, 5], [0, 8.25, 3], [0, 0, 1]], np.float32))


def test_bungeenerf_with_a_reconstruction_takes_its_cameras_and_points(capture):
    capture.write_bungee()
    capture.write_binary()
    dataset = open_dataset(capture.root)
    assert dataset.num_views == 12  # test views of the benchmark itself
    assert dataset.points.num_points == 5
    assert dataset.cameras.Ks[0, 1, 1] == 35


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        ({"poses": [[0.0] * 17] * 12}, "not a rotation"),
        ({"poses": [[math.nan] * 17] * 12}, "not finite"),
        ({"poses": [[0.0] * 16] * 12}, "rows of 17"),
        ({"poses": "none"}, "17 numbers"),
        ({"poses": []}, "rows of 17"),
        ({"poses": [[0.0] * 17] * 3}, "12 photos, .* 3 poses"),
    ],
)
def test_damaged_bungeenerf_files_are_refused(capture, extra, reason):
    capture.write_bungee(**extra)
    with pytest.raises(DatasetError, match=reason):
        open_dataset(capture.root)


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_mip_nerf_360_folders_scale_the_cameras(capture, factor):
    """Writes `images`, `images_2`, `images_4` and `images_8` in the folder that contains `sparse/0`.

    Smaller photos may deviate from the ratio by a pixel.
    """
    capture.write_images()
    capture.write_binary()
    size = (40 // factor, 24 // factor)
    capture.write_images(f"images_{factor}", size)
    cameras = open_dataset(capture.root, images=f"images_{factor}").cameras
    assert (cameras.width, cameras.height) == size
    assert float(cameras.Ks[0, 0, 0]) == pytest.approx(33 / factor)


def test_tanks_and_temples_names_its_photos_by_number(capture):
    """Layout published with 3DGS: `images/000001.jpg` and a binary reconstruction of one PINHOLE camera."""
    capture.names = [f"{i + 1:06d}.jpg" for i in range(12)]
    capture.write_images()
    capture.write_binary()
    dataset = open_dataset(capture.root, split="all")
    assert dataset.cameras.names[0] == "000001"
    assert open_dataset(capture.root).cameras.names == ("000001", "000009")


def test_deep_blending_has_one_camera_per_photo(capture):
    """All photos have one size, and each has its own intrinsics."""
    capture.write_images()
    folder = capture.write_binary()
    cameras, images = struct.pack("<Q", 12), struct.pack("<Q", 12)
    for i, name in enumerate(capture.names):
        cameras += struct.pack("<IiQQ4d", i, 1, 40, 24, 30.0 + i, 31.0 + i, 20.0, 12.0)
        images += struct.pack("<I7dI", i, *capture.quaternions[i], *capture.translations[i], i)
        images += name.encode() + b"\0" + struct.pack("<Q", 0)
    (folder / "cameras.bin").write_bytes(cameras)
    (folder / "images.bin").write_bytes(images)
    dataset = open_dataset(capture.root, split="all")
    assert dataset.cameras.Ks[:, 0, 0].tolist() == [30.0 + i for i in capture.sorted_views]


def test_folders_without_photos_are_refused(capture):
    capture.write_binary()
    with pytest.raises(DatasetError, match="images: the image folder is missing"):
        open_dataset(capture.root)
    (capture.root / "images").mkdir()
    with pytest.raises(DatasetError, match="2 of 2 posed images are missing"):
        open_dataset(capture.root)
    capture.write_bungee()
    for photo in (capture.root / "images").iterdir():
        photo.unlink()
    for file in (capture.root / "sparse" / "0").iterdir():
        file.unlink()
    with pytest.raises(DatasetError, match="0 photos"):
        open_dataset(capture.root)


def test_poses_of_transforms_that_are_not_finite_are_refused(capture):
    capture.write_nerfstudio()
    path = capture.root / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][3]["transform_matrix"][0][3] = math.nan
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=r"view_01\.png' is not finite"):
        open_dataset(capture.root, split="all")


def test_alpha_is_blended_before_a_photo_is_reduced(capture):
    capture.write_images()
    capture.write_binary()
    rgba = np.zeros((24, 40, 4), np.uint8)
    rgba[:, :20] = 255
    for photo in (capture.root / "images").iterdir():
        Image.fromarray(rgba).save(photo)
    white = open_dataset(capture.root, max_width=20, background=(1.0, 1.0, 1.0)).image(0)
    assert bool((white == 1).all())
    black = open_dataset(capture.root, max_width=20).image(0)
    assert float(black[:, -4:].max()) == 0


@pytest.mark.parametrize(
    ("given", "root"),
    [
        (".", "dense"),
        ("dense/sparse", "dense"),
        ("dense/sparse/0", "dense"),
        ("dense/images", "dense"),
        ("dense/images/view_03.png", "dense"),
        ("dense/stereo", "dense"),
        ("dense/sparse/0/images.bin", "dense"),
    ],
)
def test_folders_above_and_inside_a_dataset_are_refused_with_its_path(tmp_path, given, root):
    """COLMAP writes `dense/sparse`, `dense/images` and `dense/stereo` when it removes the distortion."""
    capture = Capture(tmp_path / root)
    capture.write_images()
    capture.write_binary()
    (tmp_path / "dense" / "stereo").mkdir()
    with pytest.raises(DatasetError) as caught:
        open_dataset(tmp_path / given)
    assert str(caught.value).endswith(f"; {tmp_path / root} looks like a dataset (layout: colmap)")


def test_a_workspace_with_numbered_reconstructions_is_refused_with_the_path_of_the_first(tmp_path):
    """COLMAP's automatic reconstruction writes `dense/0`, `dense/1` and so on."""
    for number in range(2):
        capture = Capture(tmp_path / "dense" / str(number))
        capture.write_images()
        capture.write_binary()
    for given in (tmp_path, tmp_path / "dense"):
        with pytest.raises(DatasetError, match=r"dense/0 looks like a dataset"):
            open_dataset(given)


def test_folders_without_a_dataset_nearby_get_no_hint(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    with pytest.raises(DatasetError) as caught:
        open_dataset(tmp_path / "a")
    assert "looks like a dataset" not in str(caught.value)
