import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from close import assert_close
from splatwire.data import open_dataset
from splatwire.errors import DatasetError, InvalidValueError, NoViewsError, UnknownNameError

DATA = Path(os.environ.get("SPLATWIRE_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


@pytest.fixture
def scene(capture):
    capture.write_images()
    capture.write_binary()
    return capture


def test_every_eighth_view_by_name_is_a_test_view(scene):
    assert open_dataset(scene.root).cameras.names == ("view_00", "view_08")
    train = open_dataset(scene.root, split="train").cameras.names
    assert train == tuple(f"view_{i:02d}" for i in range(12) if i % 8)
    assert open_dataset(scene.root, split="all").num_views == 12


def test_first_31_views_can_be_test_views(scene):
    assert open_dataset(scene.root, test_views="first_31").num_views == 12
    with pytest.raises(DatasetError, match="no views in the split 'train'"):
        open_dataset(scene.root, split="train", test_views="first_31")


def test_cameras_and_photos_are_paired_by_name(scene):
    dataset = open_dataset(scene.root, split="all")
    assert (dataset.cameras.width, dataset.cameras.height) == (40, 24)
    for view, i in enumerate(scene.sorted_views):
        np.testing.assert_allclose(dataset.cameras.viewmats[view], scene.viewmat(i), atol=1e-6)
        assert np.array_equal(dataset.image(view), scene.pixels[i].astype(np.float32) / 255)
    assert dataset.points.num_points == 5
    picked = dataset.select([4, 1])
    assert picked.cameras.names == ("view_04", "view_01")
    assert np.array_equal(picked.image(1), dataset.image(1))


def test_text_and_binary_reconstructions_open_as_equal_data(scene, tmp_path):
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


def test_blender_splits_come_from_their_files(capture):
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
    (tmp_path / "sparse").mkdir()
    with pytest.raises(DatasetError, match=r"not a dataset.*transforms_train\.json"):
        open_dataset(scene.root.parent / "sparse")
    with pytest.raises(DatasetError, match="images_2: the image folder is missing"):
        open_dataset(scene.root, images="images_2")
    (scene.root / "images" / "view_08.png").unlink()
    with pytest.raises(DatasetError, match=r"images: 1 of 2 posed images are missing, first 'view_08\.png'"):
        open_dataset(scene.root)


def test_missing_photos_or_poses_are_named(capture):
    capture.write_blender()
    (capture.root / "transforms_test.json").unlink()
    with pytest.raises(DatasetError, match=r"transforms_test\.json: no such file"):
        open_dataset(capture.root)


def test_photos_inconsistent_with_their_cameras_are_refused(scene):
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
def test_real_datasets_are_opened():
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


def listed_again(capture, name):
    """Writes a nerfstudio model with the first photo as its last frame under another name."""
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"].append({**content["frames"][0], "file_path": name})
    path.write_text(json.dumps(content))


@pytest.mark.parametrize("split", ["train", "test", "all"])
@pytest.mark.parametrize(
    "name", ["images/view_03.png", "./images/view_03.png", "images/./view_03.png", "images//view_03.png",
             "images/view_03", "images/link.png", "other/view_03.png", "images/hard.png"],
)  # fmt: skip
def test_a_photo_with_two_frames_is_refused(capture, name, split):
    listed_again(capture, name)
    (capture.root / "images" / "link.png").symlink_to("view_03.png")
    (capture.root / "images" / "hard.png").hardlink_to(capture.root / "images" / "view_03.png")
    (capture.root / "other").symlink_to("images")
    with pytest.raises(DatasetError, match="are the same photo"):
        open_dataset(capture.root, split=split)


@pytest.mark.parametrize("split", ["train", "test", "all"])
@pytest.mark.parametrize("name", ["view_03.png", "./view_03.png", "view_03.jpg", "sub/view_03.png", "link.png"])
def test_a_photo_with_two_images_of_colmap_is_refused(capture, name, split):
    capture.write_images()
    (capture.root / "images" / "link.png").symlink_to("view_03.png")
    path = capture.write_text() / "images.txt"
    line = next(line for line in path.read_text().splitlines() if line.endswith("view_03.png"))
    path.write_text(path.read_text() + line.replace("view_03.png", name) + "\n")
    with pytest.raises(DatasetError, match="are the same photo"):
        open_dataset(capture.root, split=split)


@pytest.mark.parametrize("split", ["train", "test", "all"])
@pytest.mark.parametrize("name", ["./train/r_2", "train/r_2.png", "test/link"])
def test_a_photo_in_both_files_of_blender_is_refused(capture, name, split):
    capture.write_blender()
    (capture.root / "test" / "link.png").symlink_to("../train/r_2.png")
    path = capture.root / "transforms_test.json"
    content = json.loads(path.read_text())
    content["frames"][1]["file_path"] = name
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="are the same photo"):
        open_dataset(capture.root, split=split)


def test_one_half_of_blender_opens_without_the_photos_of_the_other(capture):
    capture.write_blender()
    for photo in (capture.root / "test").iterdir():
        photo.unlink()
    assert open_dataset(capture.root, split="train").num_views == 8
    (capture.root / "transforms_test.json").write_text("{")
    assert open_dataset(capture.root, split="train").num_views == 8


@pytest.mark.parametrize("tested", ["test", "val"])
@pytest.mark.parametrize("split", ["train", "test", "all"])
def test_a_photo_that_is_listed_for_training_and_testing_is_refused(capture, tested, split):
    names = [f"images/view_{i:02d}.png" for i in range(12)]
    capture.write_nerfstudio(**{"train_filenames": names[:9], f"{tested}_filenames": [f"./{names[8]}", *names[9:]]})
    with pytest.raises(DatasetError, match=f"'images/view_08.png' is in 'train_filenames' and in '{tested}_filenames'"):
        open_dataset(capture.root, split=split)


@pytest.mark.parametrize(
    ("lists", "split"),
    [
        ({"train_filenames": [f"images/view_{i:02d}.png" for i in range(12)], "test_filenames": []}, "test"),
        ({"train_filenames": [], "val_filenames": [], "test_filenames": []}, "train"),
    ],
)
def test_lists_that_leave_a_split_without_views_are_the_reason_of_the_error(capture, lists, split):
    capture.write_nerfstudio(**lists)
    with pytest.raises(NoViewsError, match=f"'{split}': its lists, such as '{split}_filenames', leave none"):
        open_dataset(capture.root, split=split)


def test_a_photo_with_two_poses_of_bungeenerf_is_refused(capture):
    capture.write_bungee()
    (capture.root / "images" / "view_03.png").unlink()
    (capture.root / "images" / "view_03.png").symlink_to("view_04.png")
    with pytest.raises(DatasetError, match="are the same photo"):
        open_dataset(capture.root)


def colmap_with_a_copy(capture, test, train):
    capture.write_images()
    (capture.root / "images" / test).write_bytes((capture.root / "images" / train).read_bytes())
    capture.write_binary()


def blender_with_a_copy(capture, test, train):
    capture.write_blender()
    (capture.root / "test" / test).write_bytes((capture.root / "train" / train).read_bytes())


def nerfstudio_with_a_copy(capture, test, train):
    colmap_with_a_copy(capture, test, train)
    shutil.rmtree(capture.root / "sparse")
    names = [f"images/view_{i:02d}.png" for i in range(12)]
    capture.write_nerfstudio(train_filenames=names[1:], test_filenames=names[:1])
    (capture.root / "images" / test).write_bytes((capture.root / "images" / train).read_bytes())


def bungee_with_a_copy(capture, test, train):
    capture.write_bungee()
    (capture.root / "images" / test).write_bytes((capture.root / "images" / train).read_bytes())


@pytest.mark.parametrize(
    ("write", "test", "train", "rule"),
    [
        (colmap_with_a_copy, "view_08.png", "view_03.png", None),
        (blender_with_a_copy, "r_9.png", "r_2.png", None),
        (nerfstudio_with_a_copy, "view_00.png", "view_05.png", None),
        (nerfstudio_with_a_copy, "view_08.png", "view_05.png", "every_8th"),
        (bungee_with_a_copy, "view_08.png", "view_03.png", "every_8th"),
    ],
)
def test_test_photo_equal_to_a_training_photo_gives_a_warning(capture, caplog, write, test, train, rule):
    write(capture, test, train)
    open_dataset(capture.root, split="train", test_views=rule)
    assert not caplog.messages
    open_dataset(capture.root, split="test", test_views=rule)
    assert "1 test views have the same photo as a training view, first" in caplog.text
    assert Path(test).stem in caplog.text
    assert Path(train).stem in caplog.text


def test_copies_within_one_split_give_no_warning(capture, caplog):
    colmap_with_a_copy(capture, "view_03.png", "view_04.png")
    open_dataset(capture.root, split="all")
    assert not caplog.messages
