"""Pixels that `mask_path` of nerfstudio excludes do not count."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatwire.data import open_dataset
from splatwire.errors import DatasetError


@pytest.fixture
def masked(capture):
    """A nerfstudio folder with every second frame has a mask of the left half."""
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    (capture.root / "masks").mkdir()
    for frame in content["frames"][::2]:
        frame["mask_path"] = f"./masks/{frame['file_path'].split('/')[1]}"
        half = np.zeros((capture.height, capture.width), np.uint8)
        half[:, :20] = 255
        Image.fromarray(half).save(capture.root / frame["mask_path"])
    path.write_text(json.dumps(content))
    return capture


def test_masks_are_paired_with_their_views(masked):
    dataset, marked = open_dataset(masked.root, split="all"), {name[:-4] for name in masked.names[::2]}
    for view, name in enumerate(dataset.cameras.names):
        mask = dataset.mask(view)
        assert (mask is not None) == (name in marked)
        assert mask is None or (bool(mask[:, :20].all()) and not bool(mask[:, 20:].any()))
    backwards = dataset.select(list(reversed(range(dataset.num_views))))
    assert backwards.mask_paths == dataset.mask_paths[::-1]


def test_masks_follow_the_size_of_the_photos(masked):
    dataset = open_dataset(masked.root, split="all", max_width=20)
    mask = dataset.mask(next(view for view, path in enumerate(dataset.mask_paths) if path))
    assert mask.shape == (12, 20)
    assert int(mask.sum()) == 120
    for folder in ("images", "masks"):
        (masked.root / f"{folder}_2").mkdir()
        for file in (masked.root / folder).iterdir():
            Image.open(file).resize((20, 12)).save(masked.root / f"{folder}_2" / file.name)
    smaller = open_dataset(masked.root, split="all", images="images_2")
    assert {path.parent.name for path in smaller.mask_paths if path} == {"masks_2"}


def test_empty_mask_is_refused(masked):
    for file in (masked.root / "masks").iterdir():
        Image.new("L", (masked.width, masked.height)).save(file)
    dataset = open_dataset(masked.root, split="all")
    view = next(view for view, path in enumerate(dataset.mask_paths) if path)
    with pytest.raises(DatasetError, match=f"mask of view '{dataset.cameras.names[view]}' leaves nothing"):
        dataset.mask(view)


def test_dataset_without_masks_returns_no_masks(capture):
    dataset = open_dataset(capture.write_nerfstudio(), split="all")
    assert dataset.mask_paths == ()
    assert dataset.mask(0) is None


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda file: file.unlink(), r"the mask 'masks/view_03\.png' of view .* is missing"),
        (
            lambda file: Image.new("L", (24, 40)).save(file),
            r"the mask is 24 x 40 pixels, its photo view_03\.png 40 x 24",
        ),
        (lambda file: file.write_text("no image"), "not a readable image"),
    ],
)
def test_wrong_masks_are_refused_when_the_folder_is_opened(masked, spoil, reason):
    spoil(masked.root / "masks" / masked.names[0])
    with pytest.raises(DatasetError, match=reason):
        open_dataset(masked.root, split="all")


@pytest.mark.parametrize(("path", "reason"), [(3, "is not a path"), ("../view.png", "does not stay inside")])
def test_wrong_mask_paths_are_refused(masked, path, reason):
    file = masked.root / "transforms.json"
    content = json.loads(file.read_text())
    content["frames"][1]["mask_path"] = path
    file.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=reason):
        open_dataset(masked.root, split="all")


def test_folders_of_masks_that_no_view_names_give_a_warning(capture, caplog):
    capture.write_images()
    capture.write_binary()
    open_dataset(capture.root)
    assert not caplog.text
    (capture.root / "masks").mkdir()
    (capture.root / "masks" / "view_00.png.png").write_bytes(b"")
    open_dataset(capture.root)
    assert "its folder masks is not read" in caplog.text


@pytest.mark.parametrize("half", ["train", "test"])
def test_masks_of_one_split_are_read_masks(half, capture, caplog):
    capture.write_blender()
    (capture.root / "masks").mkdir()
    file = capture.root / f"transforms_{half}.json"
    content = json.loads(file.read_text())
    Image.new("L", (capture.width, capture.height), 255).save(capture.root / "masks" / "a.png")
    content["frames"][0]["mask_path"] = "masks/a.png"
    file.write_text(json.dumps(content))
    for split in ("train", "test"):
        assert bool(open_dataset(capture.root, split=split).mask_paths) == (split == half)
    assert "is not read" not in caplog.text


def test_folders_of_masks_that_cannot_be_listed_give_a_warning(capture, caplog, monkeypatch):
    capture.write_images()
    capture.write_binary()
    (capture.root / "masks").mkdir()
    listed = Path.iterdir

    def refuse(path):
        if path.name == "masks":
            raise PermissionError(13, "Permission denied")
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", refuse)
    open_dataset(capture.root)
    assert "its folder of masks cannot be listed: Permission denied" in caplog.text
