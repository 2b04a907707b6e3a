"""Datasets, cameras and photos with unexpected bytes and numbers are read or refused in one sentence."""

import json
import random
import re

import pytest
from PIL import Image

from mutations import attack, mutated_bytes, mutated_json
from scenes import tiny_cameras
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.data.photos import load_mask, load_photo
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.types.cameras import MAX_PIXELS


def test_hostile_camera_files_are_one_error(tmp_path):
    path, rng = tmp_path / "cameras.json", random.Random(0)
    save_cameras(tiny_cameras(2), path)
    data = path.read_bytes()
    content = json.loads(data)
    official = {"cameras": [{**view, "w2c": view["viewmat"], "width": 8, "height": 6} for view in content["cameras"]]}
    for good in (content, official):
        refused = attack(path, lambda: mutated_json(good, rng).encode(), lambda: load_cameras(path), 150)  # noqa: B023
        assert refused > 50
    attack(path, lambda: mutated_bytes(data, rng), lambda: load_cameras(path), 100)


@pytest.mark.parametrize("layout", ["blender", "nerfstudio", "bungee"])
def test_hostile_transforms_json_is_one_error(capture, layout):
    root = getattr(capture, f"write_{layout}")()
    name = {"blender": "transforms_test.json", "nerfstudio": "transforms.json", "bungee": "poses_enu.json"}[layout]
    content, rng = json.loads((root / name).read_text()), random.Random(0)
    read = lambda: open_dataset(root, split="test")  # noqa: E731
    assert attack(root / name, lambda: mutated_json(content, rng).encode(), read, 80) > 10


@pytest.mark.parametrize("layout", ["binary", "text"])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_hostile_colmap_files_are_one_error(capture, layout, name):
    capture.write_images()
    folder, rng = getattr(capture, f"write_{layout}")(), random.Random(0)
    path = folder / f"{name}.{'bin' if layout == 'binary' else 'txt'}"
    data = path.read_bytes()
    read = lambda: open_dataset(capture.root, split="all")  # noqa: E731
    attack(path, lambda: mutated_bytes(data, rng), read, 40)


@pytest.mark.filterwarnings("ignore")  # raised by Pillow for odd metadata
@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP", "BMP", "TIFF"])
def test_hostile_photos_are_one_error(tmp_path, form):
    path, rng = tmp_path / "a", random.Random(0)
    Image.effect_noise((24, 16), 80).convert("RGB").save(path, form)
    data = path.read_bytes()
    attack(path, lambda: mutated_bytes(data, rng), lambda: (load_photo(path), load_mask(path, (8, 8))), 150)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": [64]}, "whole numbers"),
        ({"width": 64.5}, "whole numbers"),
        ({"width": True}, "whole numbers"),
        ({"width": 10**6, "height": 10**6}, "over the limit"),
        ({"width": 10**400}, "over the limit"),
        ({"width": MAX_PIXELS + 1, "height": 1}, "over the limit"),
        ({"height": 0}, "no pixels"),
    ],
)
def test_impossible_picture_sizes_are_refused(tmp_path, change, words):
    path = tmp_path / "cameras.json"
    save_cameras(tiny_cameras(1), path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(DatasetError, match=f"{re.escape(str(path))}: .*{words}"):
        load_cameras(path)


def test_scaled_cameras_keep_the_size_limit():
    with pytest.raises(InvalidValueError, match="over the limit"):
        tiny_cameras(1, 8000, 8000).scaled(2.0)


def test_image_names_cannot_leave_the_folder(capture):
    capture.write_nerfstudio()
    path = capture.root / "transforms.json"
    content = json.loads(path.read_text())
    Image.new("RGB", (40, 24)).save(capture.root.with_suffix(".png"))  # outside the dataset
    for name in (".", "./", "", "/etc/x", "a/../../scene", "C:x"):
        content["frames"][0]["file_path"] = name
        path.write_text(json.dumps(content))
        with pytest.raises(DatasetError, match="stay inside"):
            open_dataset(capture.root, split="all")


def test_endless_line_is_not_read_whole(capture, monkeypatch):
    monkeypatch.setattr("splatwire.data._colmap_text._MAX_LINE_BYTES", 1000)
    capture.write_images()
    path = capture.write_text() / "points3D.txt"
    path.write_text("1 2 3" + "0" * 5000)
    with pytest.raises(DatasetError, match=r"points3D.txt: line 1 does not end"):
        open_dataset(capture.root, split="all")
