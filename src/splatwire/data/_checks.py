"""Checks that every camera reader shares."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.scene import Cameras
from splatwire.scene.cameras import check_size
from splatwire.scene.origin import choose_origin

_MAX_NUMBER = 1e12
_MIN_FOCAL_PX = 1e-3
_RIGID_TOLERANCE = 1e-3


def make_cameras(
    source: Path, names: Sequence[str], viewmats: np.ndarray, intrinsics: np.ndarray, width: int, height: int
) -> Cameras:
    """Builds cameras after checking that they are finite, rigid and look through a positive focal length.

    Cameras far from 0 get an origin: float32 matrices do not hold map coordinates.

    Args:
        source: The file they come from, for messages.
        names: One per view.
        viewmats: (C, 4, 4) world-to-camera matrices, OpenCV axes.
        intrinsics: (C, 3, 3) in pixels.
        width: Image width in pixels.
        height: Image height in pixels.

    Raises:
        DatasetError: If a camera is not what it should be, or there is none.
    """
    if not len(names):
        raise DatasetError(f"{source}: has no views")
    try:
        check_size(width, height)
    except InvalidValueError as error:
        raise DatasetError(f"{source}: {error}") from None
    for name, viewmat, K in zip(names, viewmats, intrinsics, strict=True):
        check_rigid(source, name, viewmat)
        if not (np.abs(K) < _MAX_NUMBER).all() or min(K[0, 0], K[1, 1]) < _MIN_FOCAL_PX:
            raise DatasetError(f"{source}: view '{name}' has no positive, finite focal length")
    poses = np.array(viewmats, dtype=np.float64)
    origin = choose_origin(-np.einsum("cij,ci->cj", poses[:, :3, :3], poses[:, :3, 3]), wide=False)
    poses[:, :3, 3] += poses[:, :3, :3] @ np.array(origin)
    return Cameras(
        viewmats=poses.astype(np.float32),
        Ks=np.asarray(intrinsics, dtype=np.float32),
        width=width,
        height=height,
        names=tuple(names),
        origin=origin,
    )


def check_rigid(source: Path, name: str, pose: np.ndarray) -> None:
    """Checks that a 4 x 4 matrix is a rotation and a translation.

    Raises:
        DatasetError: If it is not finite, or scales, mirrors or shears.
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
    """Names views after their files: the stem where that is unique, otherwise the folders too."""
    pure = [PurePosixPath(path) for path in paths]
    if len({path.stem for path in pure}) == len(pure):
        return tuple(path.stem for path in pure)
    return tuple("_".join(path.with_suffix("").parts) for path in pure)


def matrix(source: Path, name: str, value: Any, shape: tuple[int, int]) -> np.ndarray:
    """Turns nested lists into a float64 matrix.

    Raises:
        DatasetError: If they are not numbers in that shape.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{source}: view '{name}': expected {shape[0]} x {shape[1]} numbers") from error
    if array.shape != shape:
        raise DatasetError(f"{source}: view '{name}': expected {shape[0]} x {shape[1]} numbers, found {array.shape}")
    return array


def child(root: Path, name: str, source: Path) -> Path:
    """Returns the path of `name` below `root`; an absolute name is taken if it is below `root`, too.

    Raises:
        DatasetError: If `name` leads out of `root`.
    """
    pure = PurePosixPath(name.replace("\\", "/"))
    for folder in (root, root.absolute(), root.resolve()):
        if pure.is_absolute() and pure.is_relative_to(PurePosixPath(folder.as_posix())):
            pure = pure.relative_to(PurePosixPath(folder.as_posix()))
    if not pure.parts or pure.is_absolute() or ".." in pure.parts or "\0" in name or ":" in name:
        raise DatasetError(f"{source}: image name {name[:120]!r} does not stay inside the dataset's folder")
    return root.joinpath(*pure.parts)
