"""Reads COLMAP reconstructions, binary or text: pinhole cameras, poses and sparse points."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.data import _colmap_binary, _colmap_text
from splatwire.data._checks import pinhole
from splatwire.data._colmap_types import RawCamera, RawImage
from splatwire.errors import DatasetError

_MAX_SIDE = 1 << 20
_MAX_POSE = 1e12


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Points of a reconstruction.

    Attributes:
        positions: World coordinates.
        colors: RGB in [0, 1].
    """

    positions: Float[Tensor, "P 3"]
    colors: Float[Tensor, "P 3"]

    @property
    def num_points(self) -> int:
        """Number of points, P."""
        return int(self.positions.shape[0])


@dataclass(frozen=True, eq=False)
class ColmapView:
    """One posed image.

    Attributes:
        name: File name relative to the image folder.
        viewmat: float64 (4, 4), world to camera, OpenCV axes.
        K: float64 (3, 3), for an image of `width` x `height` pixels.
        width: Width of the image that COLMAP saw.
        height: Its height.
    """

    name: str
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int


def find_reconstruction(root: Path) -> Path | None:
    """Returns the folder below `root` that holds a COLMAP reconstruction, or None."""
    for name in ("sparse/0", "sparse", "colmap/sparse/0"):
        folder = root / name
        if any((folder / f"images.{suffix}").is_file() for suffix in ("bin", "txt")):
            return folder
    return None


def read_views(folder: Path) -> list[ColmapView]:
    """Reads `cameras` and `images` (`.bin` preferred to `.txt`), sorted by image name.

    Args:
        folder: The reconstruction, usually `sparse/0`.

    Raises:
        DatasetError: If a file is missing or damaged, a pose is not finite, or a camera is not a pinhole.
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
        views.append(ColmapView(image.name, _viewmat(folder, image), _K(folder, camera), camera.width, camera.height))
    return sorted(views, key=lambda view: (Path(view.name).stem, view.name))


def read_points(folder: Path) -> SparsePoints | None:
    """Reads `points3D.bin` or `points3D.txt`; None if the reconstruction has neither.

    Raises:
        DatasetError: If the file is damaged or a point is not finite.
    """
    if not any((folder / f"points3D.{suffix}").is_file() for suffix in ("bin", "txt")):
        return None
    positions, colors = _read(folder, "points3D")
    with np.errstate(over="ignore"):
        positions = positions.astype(np.float32)
    if not np.isfinite(positions).all():
        raise DatasetError(f"{folder}: a point of points3D is not finite")
    return SparsePoints(torch.from_numpy(positions), torch.from_numpy(colors.astype(np.float32) / 255))


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
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    viewmat[:3, 3] = image.translation
    return viewmat


def _K(folder: Path, camera: RawCamera) -> np.ndarray:  # noqa: N802  # the letter of every camera API
    if camera.model == "SIMPLE_PINHOLE":
        focal, cx, cy = camera.parameters
        return pinhole(focal, focal, cx, cy)
    if camera.model == "PINHOLE":
        return pinhole(*camera.parameters)
    raise DatasetError(
        f"{folder}: camera {camera.camera_id} is of the model {camera.model}, which bends rays; only PINHOLE and "
        "SIMPLE_PINHOLE are read. Run `colmap image_undistorter` and use its output folder"
    )
