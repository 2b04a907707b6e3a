"""Validation shared by all camera readers."""

import logging
import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.types import Cameras
from splatwire.types.cameras import MAX_SKEW, check_size
from splatwire.types.origin import choose_origin

LOG = logging.getLogger(__name__)
_MAX_NUMBER = 1e12
_MIN_FOCAL_PX = 1e-3
_MIN_FOCAL = 1 / 40
"""Minimum focal length as a share of the picture's size, for a field of view of 174 degrees."""
_MAX_OFF_CENTRE = (0.2, 0.5)
"""Largest plausible distances of a principal point from the centre: along both axes, and along one axis. They are
shares of the picture's size. Intrinsics for half or twice the size have distances of 0.25 and 0.5 along both axes.
"""
_RIGID_TOLERANCE = 1e-3
_DRIVE = re.compile(r"[A-Za-z]:" if os.name != "nt" else r".*:", re.DOTALL)
"""Pattern of paths with a drive. On Windows any colon is refused; elsewhere times such as `12:30:05` are names."""


def make_cameras(
    source: Path, names: Sequence[str], viewmats: np.ndarray, intrinsics: np.ndarray, width: int, height: int
) -> Cameras:
    """Builds cameras after checking that they are finite, rigid and have positive focal lengths.

    If the cameras are far from 0, the result has an origin, to which its positions are relative.

    Args:
        source: Source file, for messages.
        names: Name of each view.
        viewmats: (C, 4, 4) world-to-camera matrices, OpenCV axes.
        intrinsics: (C, 3, 3) in pixels.
        width: Image width in pixels.
        height: Image height in pixels.

    Raises:
        DatasetError: If a camera is invalid, or there is none.
    """
    if not len(names):
        raise DatasetError(f"{source}: has no views")
    try:
        check_size(width, height)
    except InvalidValueError as error:
        raise DatasetError(f"{source}: {error}") from None
    for name, viewmat, K in zip(names, viewmats, intrinsics, strict=True):
        if any("\ud800" <= letter <= "\udfff" for letter in name):
            raise DatasetError(f"{source}: a view has the name {name[:60]!r}, which is no text")
        check_rigid(source, name, viewmat)
        if not (np.abs(K) < _MAX_NUMBER).all() or min(K[0, 0], K[1, 1]) < _MIN_FOCAL_PX:
            raise DatasetError(f"{source}: view '{name}' has no positive, finite focal length")
        if not np.allclose(K, pinhole(K[0, 0], K[1, 1], K[0, 2], K[1, 2]), rtol=0, atol=MAX_SKEW):
            raise DatasetError(
                f"{source}: the intrinsics of view '{name}' are not [fx 0 cx; 0 fy cy; 0 0 1], in pixels"
            )
        if min(K[0, 0] / width, K[1, 1] / height) < _MIN_FOCAL:
            raise DatasetError(
                f"{source}: view '{name}' has focal lengths of {K[0, 0]:.3g} and {K[1, 1]:.3g} pixels for pictures of "
                f"{width} x {height}: intrinsics are in pixels, not in shares of the size"
            )
    _warn_of_principal_points(source, names, np.asarray(intrinsics), width, height)
    poses = np.array(viewmats, dtype=np.float64)
    # High thresholds, so that cameras at usual coordinates keep these, although poses are float64.
    origin = choose_origin(-np.einsum("cij,ci->cj", poses[:, :3, :3], poses[:, :3, 3]), low_thresholds=False)
    poses[:, :3, 3] += poses[:, :3, :3] @ np.array(origin)
    return Cameras(
        viewmats=poses.astype(np.float32),
        Ks=np.asarray(intrinsics, dtype=np.float32),
        width=width,
        height=height,
        names=tuple(names),
        origin=origin,
    )


def _warn_of_principal_points(
    source: Path, names: Sequence[str], intrinsics: np.ndarray, width: int, height: int
) -> None:
    off = np.abs(intrinsics[:, :2, 2] / (width, height) - 0.5)
    both, one = _MAX_OFF_CENTRE
    unlikely = np.flatnonzero((off.min(axis=1) > both) | (off.max(axis=1) >= one))
    if len(unlikely):
        cx, cy = intrinsics[unlikely[0], :2, 2]
        LOG.warning(
            "%s: the principal point of %d of %d views is far from the centre, that of %.120r at %.4g, %.4g in a "
            "picture of %d x %d: the intrinsics may be those of another picture size",
            source, len(unlikely), len(names), names[unlikely[0]], cx, cy, width, height,
        )  # fmt: skip


def check_rigid(source: Path, name: str, pose: np.ndarray) -> None:
    """Checks that a 4 x 4 matrix is a rigid transform.

    Raises:
        DatasetError: If the matrix is not finite, or scales, mirrors or shears.
    """
    if not (np.abs(pose) < _MAX_NUMBER).all():
        raise DatasetError(f"{source}: the pose of view '{name}' is not finite")
    rotation = pose[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > _RIGID_TOLERANCE or np.linalg.det(rotation) < 0 or not np.allclose(pose[3], [0, 0, 0, 1]):
        raise DatasetError(f"{source}: the pose of view '{name}' is not a rotation and a translation")


def pinhole(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Returns the (3, 3) intrinsics of a pinhole camera."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


def view_names(paths: Sequence[str]) -> tuple[str, ...]:
    """Returns a unique name for each view: the file name of the photo without suffix.

    If file names repeat, the names of all views also contain the folders.
    """
    pure = [PurePosixPath(path) for path in paths]
    if len({path.stem for path in pure}) == len(pure):
        return tuple(path.stem for path in pure)
    return tuple(_numbered(["_".join(path.with_suffix("").parts) for path in pure]))


def without_repetitions(source: Path, names: Sequence[str]) -> list[str]:
    """Returns the names of views with numbers added to repeated ones, and logs a warning about them.

    Args:
        source: Source file, for messages.
        names: Name of each view.
    """
    distinct = _numbered(names)
    changed = [(old, new) for old, new in zip(names, distinct, strict=True) if old != new]
    if changed:
        LOG.warning(
            "%s: %d of %d views have the name of an earlier view and get a number, first %.120r: %.120r",
            source, len(changed), len(names), *changed[0],
        )  # fmt: skip
    return distinct


def _numbered(names: Sequence[str]) -> list[str]:
    """Returns names that all differ: a number is added to each repeated one."""
    taken, seen = set(names), set[str]()
    numbers: dict[str, int] = {}
    distinct = []
    for name in names:
        chosen = name
        while name in seen and chosen in taken:
            numbers[name] = numbers.get(name, 1) + 1
            chosen = f"{name}_{numbers[name]}"
        seen.add(name)
        taken.add(chosen)
        distinct.append(chosen)
    return distinct


def matrix(source: Path, name: str, value: Any, shape: tuple[int, int]) -> np.ndarray:
    """Converts nested lists to a float64 matrix.

    Raises:
        DatasetError: If the lists do not contain numbers in the required shape.
    """
    try:
        items = np.array(value, dtype=object)
        if not all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items.flat):
            raise TypeError("text, true or the like")
        array = items.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{source}: view '{name}': expected {shape[0]} x {shape[1]} numbers") from error
    if array.shape != shape:
        raise DatasetError(f"{source}: view '{name}': expected {shape[0]} x {shape[1]} numbers, found {array.shape}")
    return array


def is_file(path: Path, source: Path) -> bool:
    """Returns True if the path is an ordinary file.

    Args:
        path: The path, as named by the dataset.
        source: File or folder of the dataset that refers to the path, for error messages.

    Raises:
        DatasetError: If the path is not a valid file name, or its folder cannot be read.
    """
    try:
        return path.is_file()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is no name of a file"
        raise DatasetError(f"{source}: {path.name[:120]!r}: {why}") from error


def check_distinct(source: Path, names: Sequence[str], photos: Sequence[Path | None]) -> None:
    """Checks that no photo belongs to two views.

    Args:
        source: File with the list of views, for messages.
        names: Name of each view.
        photos: Path of each view's photo; None if the file is missing.

    Raises:
        DatasetError: If a photo has two views.
    """
    first: dict[tuple[int, int], str] = {}
    for name, photo in zip(names, photos, strict=True):
        if photo is None:
            continue
        status = photo.stat()
        before = first.setdefault((status.st_dev, status.st_ino), name)
        if before is not name:
            raise DatasetError(
                f"{source}: the views {before[:120]!r} and {name[:120]!r} are the same photo, {photo}: remove one of "
                "them, or it could be for training and for testing"
            )


def child(root: Path, name: str, source: Path) -> Path:
    """Returns the path of a file in a folder or below it.

    Args:
        root: The folder.
        name: Relative or absolute name of the file.
        source: File that contains the name, for messages.

    Raises:
        DatasetError: If `name` is outside `root`.
    """
    pure = PurePosixPath(name.replace("\\", "/"))
    for folder in (root, root.absolute(), root.resolve()):
        if pure.is_absolute() and pure.is_relative_to(PurePosixPath(folder.as_posix())):
            pure = pure.relative_to(PurePosixPath(folder.as_posix()))
    if not pure.parts or pure.is_absolute() or ".." in pure.parts or "\0" in name or _DRIVE.match(name):
        raise DatasetError(f"{source}: image name {name[:120]!r} does not stay inside the dataset's folder")
    return _existing(root, pure.parts)


def _existing(root: Path, parts: Sequence[str]) -> Path:
    """Returns the path of a file below a folder, in the spelling of the file system.

    A dataset and the file system may spell one name in different Unicode normal forms: archives and disks of macOS
    store `é` as two characters, other programs as one. If no file or subfolder has an equivalent name, the name is
    returned unchanged.

    Args:
        root: The folder.
        parts: Names of the subfolders and of the file, as the dataset spells them.
    """
    path = root
    for part in parts:
        exact = path / part
        if not part.isascii() and not os.path.exists(exact):
            exact = path / _name_in(path, part)
        path = exact
    return path


def _name_in(folder: Path, name: str) -> str:
    """Finds a file or subfolder by name, although the folder may list the name in another Unicode normal form.

    Args:
        folder: The folder.
        name: The name.

    Returns:
        The name as listed in the folder; `name` if there is no such file or subfolder.
    """
    composed = unicodedata.normalize("NFC", name)
    for form in (composed, unicodedata.normalize("NFD", name)):
        if os.path.exists(folder / form):  # without listing a folder of many photos for each of them
            return form
    names = os.listdir(folder) if folder.is_dir() else []
    return next((other for other in names if unicodedata.normalize("NFC", other) == composed), name)
