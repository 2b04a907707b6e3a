"""Reads `transforms*.json`: the Blender layout of NeRF-synthetic, and that of nerfstudio."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.data._checks import check_rigid, child, matrix, pinhole
from splatwire.data.fisheye import FisheyeLens
from splatwire.data.lens import NO_LENS, Lens, LensModel
from splatwire.data.photos import photo_size
from splatwire.errors import DatasetError
from splatwire.files.capped import read_json

_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
_IMAGES = "images/"
_PERSPECTIVE = ("", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
_OTHER_PROJECTIONS = ("latlong", "equirectangular", "ftheta_p0")
"""Keys of instant-ngp whose presence means another projection."""
_POINT_CLOUD = "ply_file_path"
_TERMS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
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
        size_is_known: False if width and height are only those of the image, because the file has none.
    """

    name: str
    image_path: Path
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int
    mask_path: Path | None = None
    lens: LensModel = NO_LENS
    size_is_known: bool = True


@dataclass(frozen=True, eq=False)
class Transforms:
    """Content of a transforms file.

    Attributes:
        views: The frames in their order.
        splits: Names of the views that `train_filenames`, `val_filenames` and `test_filenames` list, by `train`, `val`
            and `test`; only those lists that are there.
        points: The point cloud that `ply_file_path` names; None without one.
    """

    views: list[TransformsView]
    splits: dict[str, frozenset[str]]
    points: Path | None


def read_transforms(path: Path, images: str | None = None) -> Transforms:
    """Reads a transforms file.

    Poses are camera-to-world with OpenGL axes (y up, z backward). Intrinsics are `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`
    (for all frames or for each), or `camera_angle_x` (`camera_angle_y`) with a centred principal point and square
    pixels. `k1`, `k2`, `k3`, `p1` and `p2` are the lens (OpenCV's model, as nerfstudio writes it). With
    `camera_model` OPENCV_FISHEYE or `is_fisheye`, `k1` to `k4` are those of OpenCV's fisheye.

    Args:
        path: The file.
        images: Folder to take instead of a leading `images/` in the file paths (`images_4`); masks are then taken from
            the folder that is named alike (`masks_4`).

    Raises:
        DatasetError: If the file is damaged, a lens is of another model, a pose is not rigid, an image, a mask or the
            point cloud is missing, or a split lists what is no frame.
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
    views = [_read_frame(path, content, frame, images) for frame in frames]
    return Transforms(views, _splits(path, content, views, images), _points(path, content))


def _read_frame(path: Path, content: dict[str, Any], frame: dict[str, Any], images: str | None) -> TransformsView:
    name = _name(frame["file_path"], images)
    values = {**content, **frame}
    lens = _lens(path, name, values)
    image_path = _find_image(path, name)
    rows = frame.get("transform_matrix")
    if isinstance(rows, list) and len(rows) == 3:  # instant-ngp and others leave the last row out
        rows = [*rows, [0, 0, 0, 1]]
    pose = matrix(path, name, rows, (4, 4))
    check_rigid(path, name, pose)
    K, width, height = _intrinsics(path, name, values, image_path)
    viewmat = np.linalg.inv(pose @ _OPENGL_TO_OPENCV)
    mask = _find_mask(path, name, frame, images)
    return TransformsView(name, image_path, viewmat, K, width, height, mask, lens, _has_size(values))


def _name(file_path: str, images: str | None) -> str:
    """Name of a view: the path of its image, in the folder that is taken instead of `images/`."""
    name = file_path.removeprefix("./")
    return f"{images}/{name.removeprefix(_IMAGES)}" if images is not None and name.startswith(_IMAGES) else name


def _splits(
    path: Path, content: dict[str, Any], views: list[TransformsView], images: str | None
) -> dict[str, frozenset[str]]:
    known, splits = {view.name for view in views}, {}
    for split in ("train", "val", "test"):
        listed = content.get(f"{split}_filenames")
        if listed is None:
            continue
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            raise DatasetError(f"{path}: '{split}_filenames' is not a list of paths")
        splits[split] = frozenset(_name(name, images) for name in listed)
        if unknown := sorted(splits[split] - known):
            raise DatasetError(f"{path}: '{split}_filenames' lists {unknown[0][:120]!r}, which no frame has")
    return splits


def _points(path: Path, content: dict[str, Any]) -> Path | None:
    name = content.get(_POINT_CLOUD)
    if name in (None, ""):
        return None
    if not isinstance(name, str):
        raise DatasetError(f"{path}: '{_POINT_CLOUD}' is not a path")
    file = child(path.parent, name, path)
    if not file.is_file():
        raise DatasetError(f"{path}: the point cloud '{name[:120]}' of '{_POINT_CLOUD}' is missing")
    return file


def _has_size(values: dict[str, Any]) -> bool:
    return "w" in values and "h" in values


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
    if _has_size(values):
        width, height = (round(_number(path, name, values, key, 0.0)) for key in ("w", "h"))
    else:
        width, height = photo_size(image_path)
    if min(width, height) < 1:
        raise DatasetError(f"{path}: view '{name}' has an image size of {width} x {height}")
    if "fl_x" in values:
        fx = _number(path, name, values, "fl_x", math.nan)
        fy = _number(path, name, values, "fl_y", fx)
    else:
        key, side = ("camera_angle_x", width) if "camera_angle_x" in values else ("camera_angle_y", height)
        angle = _number(path, name, values, key, math.nan)
        if not 0 < angle < math.pi:
            raise DatasetError(f"{path}: view '{name}' has neither 'fl_x' nor a 'camera_angle_x' between 0 and pi")
        fx = fy = side / (2 * math.tan(angle / 2))
    cx, cy = _number(path, name, values, "cx", width / 2), _number(path, name, values, "cy", height / 2)
    return pinhole(fx, fy, cx, cy), width, height


def _lens(path: Path, name: str, values: dict[str, Any]) -> LensModel:
    """Lens of a frame.

    Raises:
        DatasetError: If it is none that is undistorted here, or no perspective.
    """
    model = str(values.get("camera_model") or "").upper()
    other = next((key for key in _OTHER_PROJECTIONS if values.get(key)), None)
    if other is not None or model not in _PERSPECTIVE + _FISHEYE:
        found = f"'camera_model' {model[:60]!r}" if other is None else f"'{other}'"
        raise DatasetError(
            f"{path}: view '{name}' has {found}; perspective and OPENCV_FISHEYE photos are read. Cut panoramas into "
            "perspective photos first, for example with `ns-process-data images --camera-type equirectangular`"
        )
    fisheye = model in _FISHEYE or bool(values.get("is_fisheye"))
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    bend = [_number(path, name, values, key, 0.0) for key in keys]
    unread = [key for key in _TERMS if key not in keys and _number(path, name, values, key, 0.0) != 0]
    if unread:
        raise DatasetError(
            f"{path}: view '{name}' has a lens ({unread[0]}) beyond {', '.join(keys)}: undistort the photos first, for "
            "example with `colmap image_undistorter`"
        )
    if max(map(abs, bend)) > _MAX_BEND:
        raise DatasetError(f"{path}: view '{name}' has lens parameters that are no sensible numbers")
    return FisheyeLens(*bend) if fisheye else Lens(*bend)


def _number(path: Path, name: str, values: dict[str, Any], key: str, default: float) -> float:
    if key not in values:
        return default
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _MAX_NUMBER:
        raise DatasetError(f"{path}: view '{name}': '{key}' is not a sensible number")
    return float(value)
