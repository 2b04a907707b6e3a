"""Views that `splatwire train` reads from a dataset."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatwire.cli import _run_train
from splatwire.cli.train import Train
from splatwire.errors import DatasetError
from splatwire.neural.training.config import TrainConfig
from splatwire.types.origin import NO_ORIGIN

UTM = (451234.5, 5411876.25, 118.0)


def nerfstudio(folder: Path, center: tuple[float, float, float]) -> Path:
    """Nine photos from places around a point."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for view in range(9):
        pose = np.eye(4)
        pose[:3, 3] = np.add(center, (np.cos(view), np.sin(view), 0))
        pixels = np.full((8, 12, 3), 20 * view, np.uint8)
        Image.fromarray(pixels).save(folder / "images" / f"{view}.png")
        frames.append({"file_path": f"images/{view}.png", "transform_matrix": pose.tolist()})
    content = {"fl_x": 10.0, "fl_y": 10.0, "cx": 6.0, "cy": 4.0, "w": 12, "h": 8, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def views_of(folder: Path):
    return _run_train._datasets(Train(str(folder), "a.scene"), TrainConfig())


def test_cameras_in_map_coordinates_keep_their_origin(tmp_path, caplog):
    train, test = views_of(nerfstudio(tmp_path / "utm", UTM))
    assert train.cameras.origin == test.cameras.origin != NO_ORIGIN
    local, _ = views_of(nerfstudio(tmp_path / "local", (0, 0, 0)))
    centers = train.cameras.centers + (np.array(train.cameras.origin) - UTM)
    assert centers == pytest.approx(local.cameras.centers, abs=1e-6)
    assert not caplog.messages


def test_training_uses_the_split_lists_of_nerfstudio(tmp_path):
    folder = nerfstudio(tmp_path, (0, 0, 0))
    content = json.loads((folder / "transforms.json").read_text())
    splits = {"train_filenames": ["images/0.png", "images/8.png"], "test_filenames": ["images/3.png"]}
    (folder / "transforms.json").write_text(json.dumps(content | splits))
    train, test = views_of(folder)
    assert [[Path(name).stem for name in data.cameras.names] for data in (train, test)] == [["0", "8"], ["3"]]


def blender(folder: Path, **sizes: list[tuple[int, int]]) -> Path:
    """Splits with a list of transforms each; `sizes` has the size of each photo of a split."""
    folder.mkdir()
    for split, photos in sizes.items():
        frames = []
        for view, size in enumerate(photos):
            name = f"{split}{view}.png"
            Image.fromarray(np.full((*size[::-1], 3), 20 * view, np.uint8)).save(folder / name)
            frames.append({"file_path": name, "transform_matrix": np.eye(4).tolist()})
        content = {"camera_angle_x": 1.0, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("sizes", [{"train": [(12, 8)]}, {"train": [(12, 8)], "test": []}])
def test_training_without_test_views_gives_a_message(tmp_path, capsys, sizes):
    train, test = views_of(blender(tmp_path / "a", **sizes))
    assert (train.num_views, test) == (1, None)
    assert capsys.readouterr().err.startswith("no test views: ")


def test_test_photos_may_have_another_size_than_training_photos(tmp_path, capsys):
    train, test = views_of(blender(tmp_path / "a", train=[(12, 8)] * 2, test=[(24, 16)] * 2))
    assert (train.cameras.width, test.cameras.width) == (12, 24)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda folder: None, "all images of a dataset must have one size"),
        (lambda folder: (folder / "test1.png").unlink(), "test1"),
        (lambda folder: (folder / "test0.png").write_bytes(b"no picture"), "test0"),
        (lambda folder: (folder / "transforms_test.json").write_text("{"), "transforms_test.json"),
        (lambda folder: (folder / "transforms_test.json").write_text("{}"), "frames"),
    ],
    ids=["sizes", "missing", "damaged", "cut", "no list"],
)
def test_damaged_test_views_end_training(tmp_path, damage, reason):
    folder = blender(tmp_path / "a", train=[(12, 8)], test=[(12, 8), (24, 16)])
    damage(folder)
    with pytest.raises(DatasetError, match=reason):
        views_of(folder)
