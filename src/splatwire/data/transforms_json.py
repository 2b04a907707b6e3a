"""Reader of `transforms*.json`, the layout of NeRF-synthetic (Blender) and of nerfstudio."""

import logging
import math
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.data._checks import check_distinct, check_rigid, child, is_file, matrix, pinhole
from splatwire.data._lens_fields import contradicting_angle, is_sensor_angle, states_axes, unread_lens_fields
from splatwire.data.fisheye import FisheyeLens
from splatwire.data.lens import NO_LENS, Lens, LensModel
from splatwire.data.photos import photo_size
from splatwire.errors import DatasetError, NoViewsError
from splatwire.files.read_limited import read_json

LOG = logging.getLogger(__name__)
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
_IMAGES = "images/"
_PERSPECTIVE = ("", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
_OTHER_PROJECTIONS = ("latlong", "equirectangular", "ftheta_p0")
"""Keys of instant-ngp that indicate an unsupported projection."""
_POINT_CLOUD = "ply_file_path"
_CROP_RADIUS = "fisheye_crop_radius"
"""Radius of the circle that nerfstudio uses of fisheye photos, pixels."""
_OTHER_FRAMES = ("train_frames", "val_frames", "test_frames")
"""Lists of frames besides `frames`, such as the test views of ScanNet++."""
_TERMS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_LISTED_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")
_LENS_FIELDS = ("frames", *_TERMS, "camera_model", "is_fisheye", "distortion_params", *_OTHER_PROJECTIONS)
"""Fields that are checked elsewhere: lens fields, which are applied or refused, and the frames, which are checked one
by one.
"""
_MATRIX = re.compile(r"(?:cam(?:era)?[-_]?)?(?:intrinsics?(?:[-_]?matrix)?|K)|cam(?:era)?[-_]?matrix")
"""Names of fields with the intrinsics as a matrix."""
_ALIASES = {"fx": "fl_x", "fy": "fl_y"}
_SIZES = (("width", "height"), ("image_width", "image_height"), ("img_w", "img_h"))
"""Other names of `w` and `h`; a pair of names is used if a view has both fields."""
_SAME_NUMBER = 1e-3
"""Largest relative difference of two statements of the same intrinsics."""
_SQUARE = 0.01
"""Largest relative difference between the focal lengths along x and y that follow from two angles of view."""
_CONVENTION_OF_FRAME = re.compile(r"\w+[-_ ](?:convention|system)", re.I)
"""Names of fields of a frame that may state other axes of the poses. The field `camera` is not among them, because it
may name a camera.
"""
_OPENGL = re.compile(r".*(?:opengl|blender|nerf|instant|ngp|rub).*", re.I)
_WORLD_TO_CAMERA = re.compile(r"(?:is[-_]?)?(?:w2c|world[-_]?(?:to|2)[-_]?cam(?:era)?)", re.I)
"""Names of flags, and values of fields, that state poses from world to camera."""
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_MAX_DISTORTION = 1e3
_MAX_NUMBER = 1e12
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PosedPhoto:
    """Photo with its camera, from a transforms file or a `poses_enu.json`.

    Attributes:
        name: Path of the image as the transforms file states it (with its suffix, if it states one), without a leading
            `./`, and with the requested image folder in place of `images/`; with `poses_enu.json`, the file name of the
            image without suffix.
        image_path: The image.
        viewmat: float64 (4, 4), world to camera, OpenCV axes.
        K: float64 (3, 3), for an image of `width` x `height` pixels.
        width: Image width for `K`, pixels.
        height: Image height for `K`, pixels.
        mask_path: File with the mask of the image; None without a mask.
        lens: Distortion of the lens.
        size_is_known: False if width and height are those of the image, and not stated in the file of poses.
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
        views: The frames in file order.
        splits: Names of the training, validation and test views, with the keys `train`, `val` and `test`. A key is
            missing if the file has no such list.
        points: The point cloud named by the key `ply_file_path`; None if the file lacks this key.
    """

    views: list[PosedPhoto]
    splits: dict[str, frozenset[str]]
    points: Path | None


def names_masks(path: Path) -> bool:
    """Returns True if a frame of a transforms file names a mask; False for a damaged file."""
    with suppress(DatasetError):
        content = read_json(path, DatasetError)
        frames = content.get("frames") if isinstance(content, dict) else None
        return isinstance(frames, list) and any(isinstance(frame, dict) and frame.get("mask_path") for frame in frames)
    return False


def read_transforms(path: Path, images: str | None = None) -> Transforms:
    """Reads a transforms file.

    Poses are camera-to-world with OpenGL axes (y up, z backward). Intrinsics are `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`
    (common or per frame), a matrix, or `camera_angle_x`. The lens distortion is that of OpenCV's standard model (`k1`,
    `k2`, `k3`, `p1`, `p2`) or of its fisheye model (`k1` to `k4`).

    Args:
        path: The file.
        images: Folder that replaces a leading `images/` in file paths (`images_4`); masks are read from the
            corresponding folder (`masks_4`).

    Raises:
        NoViewsError: If its list of frames is empty.
        DatasetError: If the file is damaged or contradicts itself, a lens model is not supported, a pose is not rigid,
            or a file that it names is missing. Also if a photo is listed twice, or is in both the training and the test
            split.
    """
    content = read_json(path, DatasetError)
    frames = content.get("frames") if isinstance(content, dict) else None
    if frames == []:
        raise NoViewsError(f"{path}: has no views ('frames' is empty)")
    if not isinstance(frames, list):
        raise DatasetError(f"{path}: has no views ('frames' is missing or no list)")
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise DatasetError(f"{path}: frame {number} has no 'file_path'")
    if images is not None and not any(frame["file_path"].removeprefix("./").startswith(_IMAGES) for frame in frames):
        raise DatasetError(f"{path}: its paths do not begin with {_IMAGES}, which {images} would replace")
    _warn_of_conventions(path, content, frames)
    _warn_of_times(path, frames)
    if content.get(_CROP_RADIUS):
        LOG.warning(
            "%s: '%s' is not read: black corners of the photos count; mask them with 'mask_path'", path, _CROP_RADIUS
        )
    if others := [name for name in _OTHER_FRAMES if content.get(name)]:
        LOG.warning("%s: '%s' is not read: all views are those of 'frames', test views too", path, others[0])
    views = [_read_frame(path, content, frame, images) for frame in frames]
    check_distinct(path, [view.name for view in views], [view.image_path for view in views])
    return Transforms(views, _splits(path, content, views, images), _points(path, content))


def _warn_of_conventions(path: Path, content: dict[str, Any], frames: list[dict[str, Any]]) -> None:
    """Logs a warning about each field that declares pose conventions unlike OpenGL (axes or direction).

    Args:
        path: The file, for the message.
        content: JSON object of the file.
        frames: JSON objects of the frames.
    """
    stated = list(content.items())
    for frame in frames:
        stated += [(key, value) for key, value in frame.items() if _CONVENTION_OF_FRAME.fullmatch(key)]
    texts = [(key, value) for key, value in stated if states_axes(key, value) and not _OPENGL.fullmatch(value)]
    for holder in (content, *frames):
        turned = [
            key
            for key, value in holder.items()
            if (value is True and _WORLD_TO_CAMERA.fullmatch(key))
            or (isinstance(value, str) and _WORLD_TO_CAMERA.fullmatch(value))
        ]
        if turned:
            LOG.warning(
                "%s: %.40s states poses from world to camera: they are read as camera to world", path, turned[0]
            )
            break
    for key, value in dict.fromkeys(texts):
        LOG.warning("%s: %.40s is %.40r: poses are read with OpenGL axes (y up, z backward)", path, key, value)


def _warn_of_times(path: Path, frames: list[dict[str, Any]]) -> None:
    """Logs a warning if frames have different times, as in datasets of moving scenes (D-NeRF)."""
    times = {float(time) for frame in frames if isinstance(time := frame.get("time"), int | float)}
    if len(times) > 1:
        LOG.warning(
            "%s: its frames are of %d times, %g to %g: they are read as photos of a scene that does not move",
            path, len(times), min(times), max(times),
        )  # fmt: skip


def listed_photos(path: Path, images: str | None = None) -> dict[str, Path]:
    """Returns the photos listed in a transforms file, by name; missing or damaged entries are skipped.

    Args:
        path: The file.
        images: Folder that replaces a leading `images/` in file paths, or None.
    """
    photos = {}
    with suppress(DatasetError):
        content = read_json(path, DatasetError)
        frames = content.get("frames") if isinstance(content, dict) else None
        for frame in frames if isinstance(frames, list) else []:
            if isinstance(frame, dict) and isinstance(frame.get("file_path"), str):
                name = _name(frame["file_path"], images)
                with suppress(DatasetError):
                    photos[name] = _find_image(path, name)
    return photos


def _read_frame(path: Path, content: dict[str, Any], frame: dict[str, Any], images: str | None) -> PosedPhoto:
    name = _name(frame["file_path"], images)
    of_frame, common = (_with_intrinsics(path, name, fields) for fields in (frame, content))
    terms = {**_listed_terms(path, name, common), **_own_terms(of_frame), **_listed_terms(path, name, of_frame)}
    values = _with_size({**common, **of_frame, **terms})
    lens = _lens(path, name, values)
    image_path = _find_image(path, name)
    rows = frame.get("transform_matrix")
    if isinstance(rows, list) and len(rows) == 3:  # instant-ngp and others omit the last row
        rows = [*rows, [0, 0, 0, 1]]
    pose = matrix(path, name, rows, (4, 4))
    check_rigid(path, name, pose)
    sized_path = image_path
    if not _has_size(values) and _pixel_fields(values) and name != (full := _name(frame["file_path"], None)):
        sized_path = _full_photo(path, name, full, values)
    K, width, height = _intrinsics(path, name, values, sized_path)
    # Focal lengths of one frame may differ from a common angle of view, as in captures with autofocus.
    why = contradicting_angle(
        of_frame if "fl_x" in of_frame else values, (float(K[0, 0]), float(K[1, 1])), (width, height)
    )
    if why is not None:
        raise DatasetError(f"{path}: view '{name}' {why}: remove the wrong one")
    viewmat = np.linalg.inv(pose @ _OPENGL_TO_OPENCV)
    mask = _find_mask(path, name, frame, images)
    return PosedPhoto(name, image_path, viewmat, K, width, height, mask, lens, _has_size(values))


def _name(file_path: str, images: str | None) -> str:
    """Returns the name of a view: path of the image in the transforms file, without a leading `./`.

    Args:
        file_path: Path of the image in the transforms file.
        images: Folder that replaces a leading `images/`; None to keep the path.
    """
    name = file_path.removeprefix("./")
    return f"{images}/{name.removeprefix(_IMAGES)}" if images is not None and name.startswith(_IMAGES) else name


def _splits(
    path: Path, content: dict[str, Any], views: list[PosedPhoto], images: str | None
) -> dict[str, frozenset[str]]:
    names, splits = {view.name for view in views}, {}
    for split in ("train", "val", "test"):
        listed = content.get(f"{split}_filenames")
        if listed is None:
            continue
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            raise DatasetError(f"{path}: '{split}_filenames' is not a list of paths")
        splits[split] = frozenset(_name(name, images) for name in listed)
        if unknown := sorted(splits[split] - names):
            raise DatasetError(f"{path}: '{split}_filenames' lists {unknown[0][:120]!r}, which no frame has")
    tested = "test" if splits.get("test") else "val"
    if shared := sorted(splits.get("train", frozenset()) & splits.get(tested, frozenset())):
        raise DatasetError(f"{path}: {shared[0][:120]!r} is in 'train_filenames' and in '{tested}_filenames'")
    return splits


def _points(path: Path, content: dict[str, Any]) -> Path | None:
    name = content.get(_POINT_CLOUD)
    if name in (None, ""):
        return None
    if not isinstance(name, str):
        raise DatasetError(f"{path}: '{_POINT_CLOUD}' is not a path")
    file = child(path.parent, name, path)
    if not is_file(file, path):
        raise DatasetError(f"{path}: the point cloud '{name[:120]}' of '{_POINT_CLOUD}' is missing")
    return file


def _has_size(values: dict[str, Any]) -> bool:
    return "w" in values and "h" in values


def _with_size(values: dict[str, Any]) -> dict[str, Any]:
    """Adds the fields `w` and `h` to a view that states the image size under other names, such as `width`.

    Any other view is returned unchanged.

    Args:
        values: Fields of the view.
    """
    pair = next((pair for pair in _SIZES if all(type(values.get(key)) in (int, float) for key in pair)), None)
    if pair is None or "w" in values or "h" in values:
        return values
    return values | {"w": values[pair[0]], "h": values[pair[1]]}


def _pixel_fields(values: dict[str, Any]) -> list[str]:
    """Returns the names of the intrinsics that are in pixels and so depend on the image size."""
    return [key for key in ("fl_x", "fl_y", "cx", "cy") if values.get(key) is not None]


def _full_photo(path: Path, name: str, full: str, values: dict[str, Any]) -> Path:
    """Finds the full-size photo of a view, whose size is needed to scale intrinsics to smaller copies of the photos.

    Called only for intrinsics in pixels, and if the transforms file does not state the size.

    Args:
        path: The transforms file, for the message.
        name: Name of the view in the folder that is read.
        full: Path of the full-size photo, as written in the transforms file.
        values: Fields of the view in the transforms file, for the message.

    Raises:
        DatasetError: If the photo is missing, so that its size is unknown.
    """
    try:
        return _find_image(path, full)
    except DatasetError as error:
        raise DatasetError(
            f"{path}: view '{name}' has '{_pixel_fields(values)[0]}' for the photo '{full}', which is missing, and no "
            "'w' and 'h': add them"
        ) from error


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
    if not is_file(file, path):
        raise DatasetError(f"{path}: the mask '{mask}' of view '{name}' is missing")
    return file


def _find_image(path: Path, name: str) -> Path:
    base = child(path.parent, name, path)
    for suffix in _SUFFIXES:
        candidate = base.with_name(base.name + suffix)
        if is_file(candidate, path):
            return candidate
    raise DatasetError(f"{path}: the image '{name}' is missing")


def _intrinsics(path: Path, name: str, values: dict[str, Any], image_path: Path) -> tuple[np.ndarray, int, int]:
    if _has_size(values):
        width, height = (round(_number(path, name, values, key, 0.0)) for key in ("w", "h"))
    else:
        width, height = photo_size(image_path)
        for key, side in (("w", width), ("h", height)):
            if (stated := _number(path, name, values, key, float(side))) != side:
                raise DatasetError(
                    f"{path}: view '{name}' has '{key}' of {stated:g} without the other side, but its photo is "
                    f"{width} x {height}: add 'w' and 'h'"
                )
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
    vertical = _number(path, name, values, "camera_angle_y", 0.0)
    if "fl_x" not in values and 0 < vertical < math.pi and not is_sensor_angle(values):
        other = height / (2 * math.tan(vertical / 2))
        fy = other if math.isclose(fx, other, rel_tol=_SQUARE) else fx  # a larger difference is an error of the file
    cx, cy = _number(path, name, values, "cx", width / 2), _number(path, name, values, "cy", height / 2)
    return pinhole(fx, fy, cx, cy), width, height


def _with_intrinsics(path: Path, name: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Returns the fields of a view with all intrinsics under their usual names `fl_x`, `fl_y`, `cx` and `cy`.

    Raises:
        DatasetError: If a matrix is not that of a pinhole camera in pixels, or two fields contradict each other.
    """
    read = dict(fields)
    for key, value in fields.items():
        if value is None:
            continue
        stated = {_ALIASES[key]: value} if key in _ALIASES else {}
        if _MATRIX.fullmatch(key):
            stated = _matrix_terms(path, name, key, value)
        for term, number in stated.items():
            before, number = _number(path, name, read, term, math.nan), _number(path, name, {term: number}, term, 0.0)
            if abs(before - number) > _SAME_NUMBER * max(abs(before), abs(number)):
                raise DatasetError(
                    f"{path}: view '{name}' has two values of {term}, {before:g} and {number:g} ('{key}')"
                )
            read.setdefault(term, number)
    return read


def _matrix_terms(path: Path, name: str, key: str, value: object) -> dict[str, float]:
    """Reads the intrinsics of a view from a matrix: 3 x 3 or 4 x 4 nested lists, or a list of 9 numbers.

    Args:
        path: The transforms file, for messages.
        name: Name of the view, for messages.
        key: Name of the field with the matrix, for messages.
        value: Value of the field.

    Returns:
        The intrinsics `fl_x`, `fl_y`, `cx` and `cy` by name, pixels.

    Raises:
        DatasetError: If the value has none of these forms, or is not the matrix of a pinhole camera without skew.
    """
    if isinstance(value, list) and len(value) == 9:
        value = [value[:3], value[3:6], value[6:]]
    size = 4 if isinstance(value, list) and len(value) == 4 and isinstance(value[0], list) else 3
    try:
        K = matrix(path, name, value, (size, size))[:3, :3]
    except DatasetError as error:
        raise DatasetError(f"{path}: view '{name}' has '{key}', which is no 3 x 3 matrix: write 'fl_x', …") from error
    if not np.allclose(K, pinhole(K[0, 0], K[1, 1], K[0, 2], K[1, 2]), atol=_SAME_NUMBER):
        raise DatasetError(
            f"{path}: view '{name}' has '{key}', which is not [fx 0 cx; 0 fy cy; 0 0 1]: write 'fl_x', …"
        )
    return {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}


def _lens(path: Path, name: str, values: dict[str, Any]) -> LensModel:
    """Returns the lens of a frame in a transforms file: distortion model and coefficients.

    Raises:
        DatasetError: If the lens model is not supported, e.g. that of a panorama, or a parameter is invalid.
    """
    model = values.get("camera_model") or ""
    if not isinstance(model, str):
        raise DatasetError(f"{path}: view '{name}': 'camera_model' is not a name")
    model = model.upper()
    other = next((key for key in _OTHER_PROJECTIONS if _as_bool(path, name, values, key)), None)
    if other is not None or model not in _PERSPECTIVE + _FISHEYE:
        lens_name = f"'camera_model' {model[:60]!r}" if other is None else f"'{other}'"
        raise DatasetError(
            f"{path}: view '{name}' has {lens_name}; perspective and OPENCV_FISHEYE photos are read. Cut panoramas "
            "into perspective photos first, for example with `ns-process-data images --camera-type equirectangular`"
        )
    if unapplied := unread_lens_fields(values, _LENS_FIELDS):
        raise DatasetError(
            f"{path}: view '{name}' has {unapplied[0][:60]!r}, which may state a lens and is not read: name the lens "
            "in 'camera_model' and 'k1', 'k2', …, or undistort the photos first, for example with "
            "`colmap image_undistorter`"
        )
    flag = _as_bool(path, name, values, "is_fisheye")
    if model and values.get("is_fisheye") is not None and flag != (model in _FISHEYE):
        raise DatasetError(
            f"{path}: view '{name}' has 'camera_model' {model[:60]!r} and 'is_fisheye' {flag}, which contradict each "
            "other"
        )
    fisheye = model in _FISHEYE or flag
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    distortion = [_number(path, name, values, key, 0.0) for key in keys]
    unread = [key for key in _TERMS if key not in keys and _number(path, name, values, key, 0.0) != 0]
    if unread:
        raise DatasetError(
            f"{path}: view '{name}' has a lens ({unread[0]}) beyond {', '.join(keys)}: undistort the photos first, for "
            "example with `colmap image_undistorter`"
        )
    if model in _PINHOLES and any(distortion):
        raise DatasetError(
            f"{path}: view '{name}' has 'camera_model' {model!r} and the distortion of a lens, which contradict "
            "each other"
        )
    if max(map(abs, distortion)) > _MAX_DISTORTION:
        raise DatasetError(f"{path}: view '{name}' has lens parameters that are no sensible numbers")
    return FisheyeLens(*distortion) if fisheye else Lens(*distortion)


def _own_terms(frame: dict[str, Any]) -> dict[str, Any]:
    """Returns the lens parameters of a single frame, which take precedence over the lens parameters of the file."""
    return {key: frame[key] for key in _LISTED_TERMS if frame.get(key) is not None}


def _listed_terms(path: Path, name: str, values: dict[str, Any]) -> dict[str, float]:
    """Returns the lens parameters in nerfstudio's list `distortion_params` by name; empty if there is no list.

    Args:
        path: The file, for messages.
        name: Name of the view.
        values: Fields of a frame, or of the whole file.

    Raises:
        DatasetError: If the list has another length, or contradicts a field such as `k1` of the same frame.
    """
    listed = values.get("distortion_params")
    if listed is None:
        return {}
    if not isinstance(listed, list) or len(listed) != len(_LISTED_TERMS):
        raise DatasetError(f"{path}: view '{name}': 'distortion_params' is not the list {', '.join(_LISTED_TERMS)}")
    terms = dict(zip(_LISTED_TERMS, listed, strict=True))
    if other := next((key for key in terms if values.get(key) not in (None, 0, terms[key])), None):
        raise DatasetError(f"{path}: view '{name}' has two values of {other}: see 'distortion_params'")
    return terms


def _as_bool(path: Path, name: str, values: dict[str, Any], key: str) -> bool:
    """Interprets a JSON value as a flag: `true` and all numbers except 0 are True."""
    value = values.get(key)
    if value is not None and not isinstance(value, (bool, int, float)):
        raise DatasetError(f"{path}: view '{name}': '{key}' is {str(value)[:60]!r}, neither true nor false")
    return bool(value)


def _number(path: Path, name: str, values: dict[str, Any], key: str, default: float) -> float:
    if key not in values:
        return default
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _MAX_NUMBER:
        raise DatasetError(f"{path}: view '{name}': '{key}' is not a sensible number")
    return float(value)
