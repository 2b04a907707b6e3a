"""Reads COLMAP reconstructions, binary or text: cameras with their lenses, poses and sparse points."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.data import _colmap_binary, _colmap_text
from splatwire.data._checks import pinhole
from splatwire.data._colmap_types import RawCamera, RawImage
from splatwire.data.fisheye import DivisionLens, EucmLens, FisheyeLens, FovLens, RadTanThinPrismLens
from splatwire.data.lens import NO_LENS, Lens, LensModel
from splatwire.data.point_cloud import SparsePoints
from splatwire.errors import DatasetError
from splatwire.ops.quaternions import rotation_rows

_MAX_SIDE = 1 << 20
_MAX_POSE = 1e12
_MAX_BEND = 1e3
_LENSES: dict[str, tuple[int, Callable[..., LensModel]]] = {
    "SIMPLE_PINHOLE": (1, Lens),
    "PINHOLE": (2, Lens),
    "SIMPLE_RADIAL": (1, Lens),
    "RADIAL": (1, Lens),
    "OPENCV": (2, Lens),
    "FULL_OPENCV": (2, Lens),
    "SIMPLE_FISHEYE": (1, FisheyeLens),
    "FISHEYE": (2, FisheyeLens),
    "SIMPLE_RADIAL_FISHEYE": (1, FisheyeLens),
    "RADIAL_FISHEYE": (1, FisheyeLens),
    "OPENCV_FISHEYE": (2, FisheyeLens),
    "THIN_PRISM_FISHEYE": (2, lambda k1, k2, p1, p2, k3, k4, *prism: FisheyeLens(k1, k2, k3, k4, p1, p2, *prism)),
    "RAD_TAN_THIN_PRISM_FISHEYE": (2, RadTanThinPrismLens),
    "FOV": (2, FovLens),
    "SIMPLE_DIVISION": (1, DivisionLens),
    "DIVISION": (2, DivisionLens),
    "EUCM": (2, EucmLens),
}
"""Number of focal lengths and lens of each model; the centre and the terms of the lens follow the focal lengths."""


@dataclass(frozen=True, eq=False)
class ColmapView:
    """One posed image.

    Attributes:
        name: File name relative to the image folder.
        viewmat: float64 (4, 4), world to camera, OpenCV axes.
        K: float64 (3, 3), for an image of `width` x `height` pixels.
        width: Width of the image that COLMAP saw.
        height: Its height.
        lens: Its lens.
    """

    name: str
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int
    lens: LensModel = NO_LENS


def find_reconstruction(root: Path) -> Path | None:
    """Returns the folder below `root` that holds a COLMAP reconstruction, or None."""
    for name in ("sparse/0", "sparse", "colmap/sparse/0"):
        if _has(root / name, "images"):
            return root / name
    return root if _has(root, "images") and _has(root, "cameras") else None  # as RealityScan exports it


def _has(folder: Path, what: str) -> bool:
    return any((folder / f"{what}.{suffix}").is_file() for suffix in ("bin", "txt"))


def read_views(folder: Path) -> list[ColmapView]:
    """Reads `cameras` and `images` (`.bin` preferred to `.txt`), sorted by image name.

    Args:
        folder: The reconstruction, usually `sparse/0`.

    Raises:
        DatasetError: If a file is missing or damaged, a pose is not finite, or a camera has no simple lens.
    """
    cameras = _read(folder, "cameras")
    images = _read(folder, "images")
    if not images:
        raise DatasetError(f"{folder}: the reconstruction has no images")
    by_id = {camera.camera_id: camera for camera in cameras}
    views = []
    for image in images:
        if image.camera_id not in by_id:
            raise DatasetError(f"{folder}: image '{image.name}' refers to camera {image.camera_id}, which is not there")
        camera = by_id[image.camera_id]
        if not (0 < camera.width < _MAX_SIDE and 0 < camera.height < _MAX_SIDE):
            raise DatasetError(f"{folder}: camera {camera.camera_id} is {camera.width} x {camera.height} pixels large")
        K, lens = _optics(folder, camera)
        views.append(ColmapView(image.name, _viewmat(folder, image), K, camera.width, camera.height, lens))
    return sorted(views, key=lambda view: (Path(view.name).stem, view.name))


def read_points(folder: Path) -> SparsePoints | None:
    """Reads `points3D.bin` or `points3D.txt`; None if the reconstruction has neither.

    Raises:
        DatasetError: If the file is damaged or a point is not finite.
    """
    if not _has(folder, "points3D"):
        return None
    positions, colors = _read(folder, "points3D")
    with np.errstate(over="ignore"):
        positions = positions.astype(np.float32)
    if not np.isfinite(positions).all():
        raise DatasetError(f"{folder}: a point of points3D is not finite")
    return SparsePoints(positions, colors.astype(np.float32) / 255)


def _read(folder: Path, what: str):  # type: ignore[no-untyped-def]  # the type follows from `what`
    for suffix, module in (("bin", _colmap_binary), ("txt", _colmap_text)):
        path = folder / f"{what}.{suffix}"
        if path.is_file():
            try:
                return getattr(module, f"read_{what.lower()}")(path)
            except OSError as error:
                raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error
    raise DatasetError(f"{folder}: has neither {what}.bin nor {what}.txt")


def _viewmat(folder: Path, image: RawImage) -> np.ndarray:
    quaternion = np.array(image.quaternion, dtype=np.float64)
    largest = float(np.abs(quaternion).max())  # also where a quaternion is NaN: the comparison below is then false
    if not (1e-6 < largest < _MAX_POSE and np.isfinite(image.translation).all()):
        raise DatasetError(f"{folder}: the pose of image '{image.name}' is not finite")
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation_rows(*(quaternion / np.linalg.norm(quaternion)))
    viewmat[:3, 3] = image.translation
    return viewmat


def _optics(folder: Path, camera: RawCamera) -> tuple[np.ndarray, LensModel]:
    """Intrinsics and lens."""
    if camera.model not in _LENSES:
        raise DatasetError(
            f"{folder}: camera {camera.camera_id} is of the model {camera.model}, a panorama: cut the photos into "
            "perspective ones first, for example with COLMAP's `panorama_sfm.py`"
        )
    focals, lens = _LENSES[camera.model]
    fx, fy, (cx, cy) = camera.parameters[0], camera.parameters[focals - 1], camera.parameters[focals : focals + 2]
    bend = camera.parameters[focals + 2 :]
    if not (np.abs(bend) < _MAX_BEND).all():
        raise DatasetError(f"{folder}: camera {camera.camera_id} has lens parameters that are no sensible numbers")
    return pinhole(fx, fy, cx, cy), lens(*bend)
