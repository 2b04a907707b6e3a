"""Reader of `poses_enu.json`, the published layout of BungeeNeRF's city scenes."""

from pathlib import Path
from typing import Any

import numpy as np

from splatwire.data._checks import check_distinct, check_rigid, pinhole
from splatwire.data.photos import photo_size
from splatwire.data.transforms_json import PosedPhoto
from splatwire.errors import DatasetError
from splatwire.files.read_limited import read_json

FILE = "poses_enu.json"
_ROW = 17
_SUFFIXES = (".jpg", ".jpeg", ".png")
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def read_bungee(path: Path, images: str | None = None) -> list[PosedPhoto]:
    """Reads the views of a `poses_enu.json`; poses are in the order of the sorted photo names.

    Each pose has 17 numbers: a row-major 3 x 5 matrix (camera-to-world rotation with OpenGL axes, position, and height,
    width and focal length in pixels), then two unused distances.

    Args:
        path: Path of the file; the folder with the photos is next to it.
        images: Name of the folder with the photos, such as `images_2`; None for the folder `images`. The focal length
            is scaled to the size of the photos in this folder.

    Raises:
        DatasetError: If the file is damaged, a pose is not rigid, or the numbers of poses and photos differ.
    """
    content = read_json(path, DatasetError)
    rows = _rows(path, content)
    folder = path.parent / (images or "images")
    if not folder.is_dir():
        raise DatasetError(f"{folder}: the image folder is missing")
    photos = _photos(folder)
    if len(photos) != len(rows):
        raise DatasetError(f"{folder}: holds {len(photos)} photos, {path} has {len(rows)} poses")
    check_distinct(path, [photo.name for photo in photos], photos)
    # the focal length refers to the full-size photos; sizes in the file are used only if these are missing
    full = _photos(path.parent / "images") if images else photos
    full_width = float(photo_size(full[0])[0] if full else rows[0, 9])
    return [_view(path, row, photo, full_width) for row, photo in zip(rows, photos, strict=True)]


def _photos(folder: Path) -> list[Path]:
    entries = folder.iterdir() if folder.is_dir() else iter(())
    return sorted(file for file in entries if file.suffix.lower() in _SUFFIXES)


def _rows(path: Path, content: Any) -> np.ndarray:
    try:
        rows = np.array(content["poses"], dtype=np.float64)
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: has no 'poses' of {_ROW} numbers each") from error
    if rows.ndim != 2 or rows.shape[1] != _ROW or not len(rows):
        raise DatasetError(f"{path}: 'poses' has the shape {rows.shape}, expected rows of {_ROW} numbers")
    return rows


def _view(path: Path, row: np.ndarray, photo: Path, full_width: float) -> PosedPhoto:
    table = row[:15].reshape(3, 5)
    pose = np.eye(4)
    pose[:3] = table[:, :4]
    check_rigid(path, photo.stem, pose)
    height, width, focal = table[:, 4]
    if not (np.isfinite(table[:, 4]).all() and min(height, width, focal) >= 1):
        raise DatasetError(f"{path}: view '{photo.stem}' has height, width and focal length {table[:, 4].tolist()}")
    actual_width, actual_height = photo_size(photo)
    focal *= actual_width / full_width
    K = pinhole(focal, focal, actual_width / 2, actual_height / 2)
    viewmat = np.linalg.inv(pose @ _OPENGL_TO_OPENCV)
    return PosedPhoto(photo.stem, photo, viewmat, K, actual_width, actual_height, size_is_known=False)
