"""Photos with an EXIF orientation are rotated to match their cameras, and refused if ambiguous."""

import json

import numpy as np
import pytest
from PIL import Image

from splatwire.data import open_dataset
from splatwire.errors import DatasetError

TURNED = 6
"""Orientation that viewers rotate by 90 degrees."""


def _photos(capture, orientation, size, count=12):
    """Photos of one stored size with an orientation; their names are those of the capture."""
    exif = Image.Exif()
    exif[0x112] = orientation
    rows = np.linspace(0, 255, size[0] * size[1]).astype(np.uint8).reshape(size[1], size[0])
    capture.names = [f"{name[:-4]}.jpg" for name in capture.names]
    (capture.root / "images").mkdir(parents=True)
    for i, name in enumerate(capture.names):
        photo = Image.fromarray(np.repeat(rows[:, :, None], 3, axis=2))
        photo.save(capture.root / "images" / name, quality=100, subsampling=0, **({"exif": exif} if i < count else {}))
    return rows / 255


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_photos_are_rotated_to_match_their_cameras(capture, orientation):
    stored = _photos(capture, orientation, (24, 40))
    capture.write_binary()
    dataset = open_dataset(capture.root, split="all")
    expected = {5: stored.T, 6: np.rot90(stored, -1), 7: np.rot90(stored, 2).T, 8: np.rot90(stored)}[orientation]
    assert (dataset.cameras.width, dataset.cameras.height) == (40, 24)
    assert np.abs(dataset.select([3]).image(0)[:, :, 0] - expected).max() < 0.02


def test_photos_stay_as_stored_when_cameras_match_stored_pixels(capture):
    stored = _photos(capture, TURNED, (40, 24))
    capture.write_binary()
    assert np.abs(open_dataset(capture.root, split="all").image(3)[:, :, 0] - stored).max() < 0.02


@pytest.mark.parametrize("orientation", [2, 3, 4, 6, 8])
def test_photos_of_ambiguous_orientation_are_refused(capture, orientation):
    _photos(capture, orientation, (40, 40), count=1)
    capture.height = 40
    capture.write_binary()
    with pytest.raises(DatasetError, match=r"EXIF orientation.*auto-orient.*exiftool"):
        open_dataset(capture.root, split="all")


@pytest.mark.parametrize("rotated", [True, False])
def test_nearly_square_photos_are_oriented_by_one_pixel(capture, rotated):
    _photos(capture, TURNED, (400, 399))
    capture.width, capture.height = (399, 400) if rotated else (400, 399)
    capture.write_binary()
    assert open_dataset(capture.root, split="all").applies_exif_rotation == rotated


def test_upside_down_photo_needs_an_unambiguous_one(capture):
    stored = _photos(capture, 3, (40, 24), count=1)
    capture.write_binary()
    with pytest.raises(DatasetError, match="EXIF orientation"):
        open_dataset(capture.root, split="all")
    exif = Image.Exif()
    exif[0x112] = TURNED
    Image.fromarray(np.repeat((stored[:, :, None] * 255).astype(np.uint8), 3, 2)).save(
        capture.root / "images" / capture.names[4], exif=exif
    )
    assert not open_dataset(capture.root, split="all").applies_exif_rotation


def test_photo_size_without_a_camera_size_is_no_evidence(capture):
    _photos(capture, TURNED, (40, 24))
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": capture.c2w_opengl(i)}
        for i, name in enumerate(capture.names)
    ]
    (capture.root / "transforms.json").write_text(json.dumps({"fl_x": 33, "frames": frames}))
    with pytest.raises(DatasetError, match="EXIF orientation"):
        open_dataset(capture.root, split="all")
    (capture.root / "transforms.json").write_text(json.dumps({"fl_x": 33, "w": 40, "h": 24, "frames": frames}))
    assert not open_dataset(capture.root, split="all").applies_exif_rotation


def test_masks_are_rotated_with_their_photo(capture):
    _photos(capture, TURNED, (24, 40))
    Image.fromarray(np.tile(np.arange(40) > 20, (24, 1)).astype(np.uint8) * 255).save(capture.root / "mask.png")
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": capture.c2w_opengl(i), "mask_path": "mask.png"}
        for i, name in enumerate(capture.names)
    ]
    (capture.root / "transforms.json").write_text(json.dumps({"fl_x": 33, "w": 40, "h": 24, "frames": frames}))
    dataset = open_dataset(capture.root, split="all")
    assert dataset.image(0).shape[:2] == dataset.mask(0).shape == (24, 40)
