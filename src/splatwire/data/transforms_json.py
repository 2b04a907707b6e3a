"""Reads `transforms*.json`: the Blender layout of NeRF-synthetic, and that of nerfstudio."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.data._checks import check_rigid, child, matrix, pinhole
from splatwire.data.lens import NO_LENS, Lens
from splatwire.data.photos import photo_size
from splatwire.errors import DatasetError
from splatwire.files.capped import read_json

_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
_IMAGES = "images/"
_UNREAD = ("k3", "k4", "k5", "k6")
_MAX_BEND = 1e3
_MAX_NUMBER = 1e12
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class TransformsView:
    """One frame of a transforms file.

    Attributes:
        name: Path of the image relative to the file, without a suffix.
        image_path: The image.
        viewmat: float64 (4, 4), world to camera, OpenCV axes.
        K: float64 (3, 3), for an image of `width` x `height` pixels.
        width: Width that `K` is for.
        height: Height that `K` is for.
        mask_path: Its mask, if it has one.
        lens: Its lens.
    """

    name: str
    image_path: Path
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int
    mask_path: Path | None = None
    lens: Lens = NO_LENS


def read_transforms(path: Path, images: str | None = None) -> list[TransformsView]:
    """Reads the frames of a transforms file in their order.

    Poses are camera-to-world with OpenGL axes (y up, z backward). Intrinsics are `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`
    (for all frames or for each), or `camera_angle_x` with a centred principal point and square pixels. `k1`, `k2`, `p1`
    and `p2` are the lens (OpenCV's model, as nerfstudio writes it).

    Args:
        path: The file.
        images: Folder to take instead of a leading `images/` in the file paths (`images_4`); masks are then taken from
            the folder that is named alike (`masks_4`).

    Raises:
        DatasetError: If the file is damaged, a lens is not of that model, a pose is not rigid, or an image or mask
            is missing.
    """
    content = read_json(path, DatasetError)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise DatasetError(f"{path}: has no views ('frames' is missing or empty)")
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise DatasetError(f"{path}: frame {number} has no 'file_path'")
    if images is not None and not any(frame["file_path"].removeprefix("./").startswith(_IMAGES) for frame in frames):
        raise DatasetError(f"{path}: its paths do not begin with {_IMAGES}, which {images} would replace")
    return [_read_frame(path, content, frame, images) for frame in frames]


def _read_frame(path: Path, content: dict[str, Any], frame: dict[str, Any], images: str | None) -> TransformsView:
    name = frame["file_path"].removeprefix("./")
    if images is not None and name.startswith(_IMAGES):
        name = f"{images}/{name.removeprefix(_IMAGES)}"
    image_path = _find_image(path, name)
    pose = matrix(path, name, frame.get("transform_matrix"), (4, 4))
    check_rigid(path, name, pose)
    values = {**content, **frame}
    K, width, height = _intrinsics(path, name, values, image_path)
    viewmat = np.linalg.inv(pose @ _OPENGL_TO_OPENCV)
    mask = _find_mask(path, name, frame, images)
    return TransformsView(name, image_path, viewmat, K, width, height, mask, _lens(path, name, values))


def _find_mask(path: Path, name: str, frame: dict[str, Any], images: str | None) -> Path | None:
    mask = frame.get("mask_path")
    if mask is None:
        return None
    if not isinstance(mask, str):
        raise DatasetError(f"{path}: view '{name}': 'mask_path' is not a path")
    mask = mask.removeprefix("./")
    if images is not None and images.startswith("images") and mask.startswith("masks/"):
        mask = f"masks{images.removeprefix('images')}/{mask.removeprefix('masks/')}"
    file = child(path.parent, mask, path)
    if not file.is_file():
        raise DatasetError(f"{path}: the mask '{mask}' of view '{name}' is missing")
    return file


def _find_image(path: Path, name: str) -> Path:
    base = child(path.parent, name, path)
    for suffix in _SUFFIXES:
        candidate = base.with_name(base.name + suffix)
        if candidate.is_file():
            return candidate
    raise DatasetError(f"{path}: the image '{name}' is missing")


def _intrinsics(path: Path, name: str, values: dict[str, Any], image_path: Path) -> tuple[np.ndarray, int, int]:
    if "w" in values and "h" in values:
        width, height = (round(_number(path, name, values, key, 0.0)) for key in ("w", "h"))
    else:
        width, height = photo_size(image_path)
    if min(width, height) < 1:
        raise DatasetError(f"{path}: view '{name}' has an image size of {width} x {height}")
    if "fl_x" in values:
        fx = _number(path, name, values, "fl_x", math.nan)
        fy = _number(path, name, values, "fl_y", fx)
    else:
        angle = _number(path, name, values, "camera_angle_x", math.nan)
        if not 0 < angle < math.pi:
            raise DatasetError(f"{path}: view '{name}' has neither 'fl_x' nor a 'camera_angle_x' between 0 and pi")
        fx = fy = width / (2 * math.tan(angle / 2))
    cx, cy = _number(path, name, values, "cx", width / 2), _number(path, name, values, "cy", height / 2)
    return pinhole(fx, fy, cx, cy), width, height


def _lens(path: Path, name: str, values: dict[str, Any]) -> Lens:
    unread = [key for key in _UNREAD if _number(path, name, values, key, 0.0) != 0]
    if unread or "FISHEYE" in str(values.get("camera_model", "")).upper():
        what = unread[0] if unread else "camera_model"
        raise DatasetError(
            f"{path}: view '{name}' has a lens ({what}) beyond k1, k2, p1 and p2: undistort the photos first, for "
            "example with `colmap image_undistorter`"
        )
    bend = [_number(path, name, values, key, 0.0) for key in ("k1", "k2", "p1", "p2")]
    if max(map(abs, bend)) > _MAX_BEND:
        raise DatasetError(f"{path}: view '{name}' has lens parameters that are no sensible numbers")
    return Lens(*bend)


def _number(path: Path, name: str, values: dict[str, Any], key: str, default: float) -> float:
    if key not in values:
        return default
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _MAX_NUMBER:
        raise DatasetError(f"{path}: view '{name}': '{key}' is not a sensible number")
    return float(value)
