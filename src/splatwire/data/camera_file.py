"""Camera files in JSON: the format of this package, and the `cameras.json` of HAC++ results and 3DGS model folders."""

import json
import logging
import os
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.arguments import checked, checked_except
from splatwire.data._checks import check_rigid, make_cameras, matrix, pinhole, without_repetitions
from splatwire.data._lens_fields import contradicting_angle, states_axes, unread_lens_fields
from splatwire.errors import DatasetError, check_kind
from splatwire.files.atomic_write import atomic_write
from splatwire.files.kinds import format_error
from splatwire.files.names import path_of
from splatwire.files.read_limited import read_json
from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.origin import NO_ORIGIN

LOG = logging.getLogger(__name__)
FORMAT = "splatwire-cameras"
VERSION = 1
_MAX_NAME = 200
_SAME = 1e-3
"""Largest relative difference of two statements of the same pose or intrinsics."""
_POSES = {"w2c": False, "viewmat": False, "world_to_camera": False, "c2w": True, "camera_to_world": True}
"""Names of fields with a pose, each with True if the pose is from camera to world."""
_PRINCIPAL_POINT = re.compile(r"principal[-_ ]?points?|pp", re.I)
"""Names of fields of a camera with its principal point as a list of two numbers."""
_OPENCV = re.compile(r"opencv|colmap|rdf|3dgs|^w2c$", re.I)
"""Pattern of statements about axes and poses that agree with how files are read."""
_CONVENTION = "viewmat: world to camera, OpenCV axes; K: pixels, the centre of the top-left pixel is (0.5, 0.5)"


@checked_except("cameras")
def save_cameras(cameras: Cameras, path: str | os.PathLike[str]) -> None:
    """Writes cameras to a file atomically, without loss of precision.

    Raises:
        InvalidValueError: If `cameras` or `path` has a wrong type, or the folder does not exist.
        OSError: If the file cannot be written.
    """
    check_kind(cameras, Cameras, "splatwire.data.load_cameras")
    world = replace(cameras, viewmats=to_numpy(cameras.viewmats).astype(np.float64)).relative_to(NO_ORIGIN)
    views = [
        {"name": name, "viewmat": viewmat.tolist(), "K": K.tolist()}
        for name, viewmat, K in zip(cameras.names, world.viewmats, cameras.Ks, strict=True)
    ]
    content = {
        "format": FORMAT,
        "version": VERSION,
        "convention": _CONVENTION,
        "width": cameras.width,
        "height": cameras.height,
        "cameras": views,
    }
    if cameras.near_depth != NEAR_DEPTH:
        content["near_depth"] = cameras.near_depth
    atomic_write(path, (json.dumps(content, indent=1) + "\n").encode())


@checked
def load_cameras(path: str | os.PathLike[str]) -> Cameras:
    """Reads a cameras file of this package, of an official HAC++ result, or of a 3DGS model folder (`cameras.json`).

    Args:
        path: Path of the file.

    Raises:
        DatasetError: If the file is missing, damaged or in none of these formats, or a camera is not rigid and finite.
    """
    path = path_of(path, "a cameras file")
    content = read_json(path, DatasetError)
    if isinstance(content, list):
        return _cameras_of_3dgs(path, content)
    if not isinstance(content, dict) or not isinstance(content.get("cameras"), list):
        raise DatasetError(format_error(path, "a cameras file", "it has no list 'cameras'"))
    is_own_format = content.get("format") == FORMAT
    if is_own_format and content.get("version") != VERSION:
        raise DatasetError(f"{path}: cameras file version {content.get('version')!s:.20}, this release reads {VERSION}")
    views = content["cameras"]
    if not views:
        raise DatasetError(f"{path}: has no views")
    if not all(isinstance(view, dict) and isinstance(view.get("name"), str) for view in views):
        raise DatasetError(f"{path}: a camera has no name")
    names = without_repetitions(path, [view["name"] for view in views])
    _warn_of_lenses(path, views)
    # files of HAC++ have `w2c`, `K`, `width` and `height` in every camera
    pose_key = "viewmat" if is_own_format else "w2c"
    viewmats = np.stack([matrix(path, view["name"], view.get(pose_key), (4, 4)) for view in views])
    intrinsics = np.stack([matrix(path, view["name"], view.get("K"), (3, 3)) for view in views])
    width, height = _size(path, [content] if is_own_format else views)
    if is_own_format:
        _size(path, [content, *(view for view in views if {"width", "height"} & set(view))])
    cameras = make_cameras(path, names, viewmats, intrinsics, width, height)
    if is_own_format and "near_depth" in content:
        near_depth = matrix(path, "near_depth", [[content["near_depth"]]], (1, 1))[0, 0]
        if not 0 < near_depth < np.inf:
            raise DatasetError(f"{path}: 'near_depth' must be above 0 and finite, not {near_depth:g}")
        cameras = replace(cameras, near_depth=float(near_depth))
    _warn_of_conventions(path, [content, *views])
    for name, view, viewmat, K in zip(names, views, viewmats, intrinsics, strict=True):
        _check_statements(path, name, view, viewmat, K, (width, height))
    return cameras


def _cameras_of_3dgs(path: Path, views: list[Any]) -> Cameras:
    """Builds cameras from the parsed `cameras.json` of a 3DGS model folder.

    Args:
        path: The file, for messages.
        views: Content of the file, one JSON object for each view.
    """
    if not views:
        raise DatasetError(f"{path}: has no views")
    if not all(isinstance(view, dict) and {"position", "rotation", "fx", "fy"} <= set(view) for view in views):
        raise DatasetError(
            format_error(path, "a cameras file", "a list must hold cameras with position, rotation, fx, fy")
        )
    names = without_repetitions(path, [_name_in_3dgs(path, number, view) for number, view in enumerate(views)])
    _warn_of_lenses(path, views)
    width, height = _size(path, views)
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    intrinsics = np.empty((len(views), 3, 3))
    for number, (name, view) in enumerate(zip(names, views, strict=True)):
        poses[number, :3, :3] = matrix(path, name, view["rotation"], (3, 3))
        poses[number, :3, 3] = matrix(path, name, [view["position"]], (1, 3))[0]
        check_rigid(path, name, poses[number])
        fx, fy = matrix(path, name, [[view["fx"], view["fy"]]], (1, 2))[0]
        intrinsics[number] = pinhole(fx, fy, *_principal_point(path, name, view, (width, height)))
    viewmats = np.linalg.inv(poses)
    cameras = make_cameras(path, names, viewmats, intrinsics, width, height)
    _warn_of_conventions(path, views)
    for name, view, viewmat, K in zip(names, views, viewmats, intrinsics, strict=True):
        _check_statements(path, name, view, viewmat, K, (width, height))
    return cameras


def _principal_point(path: Path, name: str, view: dict[str, Any], size: tuple[int, int]) -> list[float]:
    """Returns the principal point of a camera of a 3DGS model folder in pixels; the picture's centre if none is stated.

    Raises:
        DatasetError: If the field is not a point in pixels, or two fields contradict each other.
    """
    stated = [
        matrix(path, name, [value], (1, 2))[0].tolist()
        for key, value in view.items()
        if _PRINCIPAL_POINT.fullmatch(key) and value is not None
    ]
    absent = stated[0] if stated else [size[0] / 2, size[1] / 2]
    stated_values = [view.get("cx"), view.get("cy")]
    if stated_values != [None, None]:
        center = [[other if value is None else value for value, other in zip(stated_values, absent, strict=True)]]
        stated.insert(0, matrix(path, name, center, (1, 2))[0].tolist())
    principal_point = stated[0] if stated else absent
    if any(not np.allclose(other, principal_point, rtol=_SAME) for other in stated):
        raise DatasetError(f"{path}: view '{name[:120]}' has two different principal points: remove the wrong one")
    # Shares of the picture's size are between 0 and 1. A picture that was cut at the principal point has 0.
    if stated and min(principal_point) > 0 and max(principal_point) <= 1 < min(size) / 2:
        raise DatasetError(
            f"{path}: view '{name[:120]}' has a principal point of {principal_point[0]:g}, {principal_point[1]:g} in a "
            f"picture of {size[0]} x {size[1]}: it must be in pixels, from the top-left corner"
        )
    return principal_point


def _check_statements(
    path: Path, name: str, view: dict[str, Any], viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> None:
    """Checks that unused fields of a camera, such as a second matrix, agree with the values that were read.

    Args:
        path: The file, for messages.
        name: Name of the view.
        view: Fields of the camera.
        viewmat: World-to-camera matrix that was read, (4, 4).
        K: Intrinsics that were read, (3, 3).
        size: Width and height of the picture, pixels.

    Raises:
        DatasetError: If a matrix or an angle of view contradicts these values.
    """
    if (why := contradicting_angle(view, (float(K[0, 0]), float(K[1, 1])), size)) is not None:
        raise DatasetError(f"{path}: view '{name[:120]}' {why}: remove the wrong one")
    for key, inverse in _POSES.items():
        with suppress(DatasetError, np.linalg.LinAlgError):  # a field of another kind
            other = matrix(path, name, view.get(key), (4, 4))
            other = np.linalg.inv(other) if inverse else other
            if not np.allclose(other, viewmat, rtol=_SAME, atol=_SAME):
                break
    else:
        key, stated = "K", view.get("K")
        if not isinstance(stated, list):
            return
        if len(stated) == K.size:
            stated = [stated[:3], stated[3:6], stated[6:]]
        with suppress(DatasetError):
            if np.allclose(matrix(path, name, stated, (3, 3)), K, rtol=_SAME, atol=_SAME):
                return
    raise DatasetError(f"{path}: view '{name[:120]}' has '{key}', which contradicts its other fields: remove one")


def _warn_of_conventions(path: Path, holders: list[dict[str, Any]]) -> None:
    """Logs a warning if a cameras file states camera axes other than OpenCV's, or camera-to-world poses.

    Args:
        path: The cameras file, for messages.
        holders: JSON objects that may have such fields: the object of the file, and the object of each view.
    """
    stated = [(key, value) for holder in holders for key, value in holder.items() if states_axes(key, value)]
    for key, value in dict.fromkeys(stated):
        if value != _CONVENTION and not _OPENCV.search(value):
            LOG.warning("%s: %.40s is %.60r: poses are read with OpenCV axes (y down, z forward)", path, key, value)


def _warn_of_lenses(path: Path, views: list[dict[str, Any]]) -> None:
    """Logs a warning about lens parameters in a cameras file, which are ignored."""
    if fields := sorted({name for view in views for name in unread_lens_fields(view)}):
        names = ", ".join(fields)[:120]
        LOG.warning("%s: fields about a lens are left out: %s; pictures are those of pinhole cameras", path, names)


def _name_in_3dgs(path: Path, number: int, view: dict[str, Any]) -> str:
    name = view.get("img_name", view.get("id", number))
    if isinstance(name, bool) or not isinstance(name, (str, int)):
        raise DatasetError(f"{path}: camera {number} has the name {str(name)[:60]!r}, which is no text")
    return str(name)[:_MAX_NAME]


def _as_integer(value: object) -> object:
    """Converts a float with an integral value to an integer, and returns any other value unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _size(path: Path, holders: list[dict[str, Any]]) -> tuple[int, int]:
    sizes = [(_as_integer(holder.get("width")), _as_integer(holder.get("height"))) for holder in holders]
    if not all(type(side) is int for size in sizes for side in size):
        raise DatasetError(f"{path}: width and height must be whole numbers")
    distinct = set(sizes)
    if len(distinct) != 1:
        raise DatasetError(f"{path}: its views have {len(distinct)} different image sizes, one is supported")
    width, height = distinct.pop()
    return width, height  # type: ignore[return-value]
