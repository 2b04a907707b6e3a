"""Reads COLMAP reconstructions, binary or text: cameras with their lenses, poses and sparse points."""

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.data import _colmap_binary, _colmap_text
from splatwire.data._checks import pinhole
from splatwire.data._colmap_types import RawCamera, RawImage
from splatwire.data.fisheye import DivisionLens, EucmLens, FisheyeLens, FovLens, RadTanThinPrismLens
from splatwire.data.lens import NO_LENS, Lens, LensModel
from splatwire.data.point_cloud import SparsePoints, positions_from, read_point_cloud
from splatwire.errors import DatasetError
from splatwire.files.colmap_folders import SUFFIXES, has_table, reconstructions
from splatwire.ops.quaternions import rotation_rows
from splatwire.types.origin import NO_ORIGIN, Origin

LOG = logging.getLogger(__name__)
_MAX_SIDE = 1 << 20
_MAX_POSE = 1e12
_MAX_DISTORTION = 1e3
_MAX_NAMED = 8
"""Maximum number of reconstructions that a warning names."""
_SAME = 1e-3
"""Largest relative difference of the same number in a binary and a text file."""
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
"""Number of focal lengths and lens class of each camera model. The parameters of a model are focal lengths, principal
point and distortion, in this order.
"""


@dataclass(frozen=True, eq=False)
class ColmapView:
    """An image of a COLMAP reconstruction with its camera.

    Attributes:
        name: File name relative to the image folder.
        viewmat: float64 (4, 4), world to camera, OpenCV axes.
        K: float64 (3, 3), for an image of `width` x `height` pixels.
        width: Image width in the reconstruction, pixels.
        height: Image height in the reconstruction, pixels.
        lens: Distortion of the lens.
    """

    name: str
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int
    lens: LensModel = NO_LENS


def find_reconstruction(root: Path) -> Path | None:
    """Returns the folder, `root` or one below it, from which a COLMAP reconstruction is read; None if there is none."""
    return next(reconstructions(root), None)


def warn_of_other_reconstructions(root: Path, folder: Path) -> None:
    """Logs a warning about the reconstructions of a dataset that are not read, with the number of images of each.

    COLMAP writes several if it cannot connect all photos.

    Args:
        root: Folder of the dataset.
        folder: Folder of the reconstruction that is read.
    """
    try:
        others = [other for other in reconstructions(root) if other != folder]
    except OSError as error:
        LOG.warning("%s: %s cannot be searched for more reconstructions: %s", root, error.filename, error.strerror)
        return
    if others:
        names = [f"{_relative_name(other, root)} ({_count_images(other)})" for other in others[:_MAX_NAMED]]
        more = f" and {len(others) - _MAX_NAMED} more" if len(others) > _MAX_NAMED else ""
        LOG.warning(
            "%s: of %d reconstructions, %s (%s) is read; the others are not: %s%s. COLMAP's `model_merger` joins "
            "models; the one in sparse/0 is preferred",
            root, len(others) + 1, _relative_name(folder, root), _count_images(folder), ", ".join(names), more,
        )  # fmt: skip


def _relative_name(folder: Path, root: Path) -> str:
    return "the one in the folder itself" if folder == root else folder.relative_to(root).as_posix()


def _count_images(folder: Path) -> str:
    """Returns the number of images of a reconstruction for a message, or "cannot be read"."""
    try:
        return f"{_read(folder, 'images', 'count_images'):,} images"
    except DatasetError:
        return "cannot be read"


def read_views(folder: Path) -> list[ColmapView]:
    """Reads cameras and images of a reconstruction (`.bin` preferred to `.txt`).

    The images are sorted by file name without folder and suffix, then by their whole name.

    Args:
        folder: Folder of the reconstruction, usually `sparse/0`.

    Raises:
        DatasetError: If a file is missing or damaged, a pose is not finite, or a camera model is not supported.
    """
    views = _views(folder, SUFFIXES)
    if all((folder / f"{table}.{suffix}").is_file() for table in ("cameras", "images") for suffix in SUFFIXES):
        _warn_of_other_text(folder, views)
    return views


def _warn_of_other_text(folder: Path, views: list[ColmapView]) -> None:
    """Logs a warning if the text files of a reconstruction are damaged, or list other views than the binary files."""
    try:
        others = {view.name: view for view in _views(folder, ("txt",))}
    except DatasetError as error:
        LOG.warning("%s: its .bin files are read; its .txt files are damaged: %s", folder, error)
        return
    equal_views = [view for view in views if view.name in others and _are_alike(view, others[view.name])]
    if len(equal_views) < max(len(views), len(others)):
        LOG.warning(
            "%s: its .bin files, which are read, have %d views, its .txt files %d, and %d are the same: remove the "
            "older files",
            folder, len(views), len(others), len(equal_views),
        )  # fmt: skip


def _are_alike(one: ColmapView, other: ColmapView) -> bool:
    """True if two views have the same size and lens, and about the same intrinsics and pose."""
    if type(one.lens) is not type(other.lens) or (one.width, one.height) != (other.width, other.height):
        return False
    first, second = (np.array([*v.K.flat, *v.viewmat.flat, *vars(v.lens).values()], np.float64) for v in (one, other))
    return np.allclose(first, second, rtol=_SAME, atol=_SAME)


def _views(folder: Path, suffixes: tuple[str, ...]) -> list[ColmapView]:
    """Reads the views of a reconstruction from binary or text files, whichever exist.

    Args:
        folder: Folder of the reconstruction.
        suffixes: File name suffixes, preferred ones first.

    Raises:
        DatasetError: If a file is missing or damaged, or the reconstruction has no images.
    """
    cameras = _read(folder, "cameras", "read_cameras", suffixes)
    images = _read(folder, "images", "read_images", suffixes)
    if not images:
        raise DatasetError(f"{folder}: the reconstruction has no images")
    by_id = {camera.camera_id: camera for camera in cameras}
    if len(by_id) < len(cameras):
        (twice, _), *_ = Counter(camera.camera_id for camera in cameras).most_common(1)
        raise DatasetError(f"{folder}: camera {twice} is there twice")
    views = []
    for image in images:
        if image.camera_id not in by_id:
            raise DatasetError(f"{folder}: image '{image.name}' refers to camera {image.camera_id}, which is not there")
        camera = by_id[image.camera_id]
        if not (0 < camera.width < _MAX_SIDE and 0 < camera.height < _MAX_SIDE):
            raise DatasetError(f"{folder}: camera {camera.camera_id} is {camera.width} x {camera.height} pixels large")
        K, lens = _intrinsics(folder, camera)
        views.append(ColmapView(image.name, _viewmat(folder, image), K, camera.width, camera.height, lens))
    return sorted(views, key=lambda view: (Path(view.name).stem, view.name))


def read_points(folder: Path, origin: Origin = NO_ORIGIN) -> SparsePoints | None:
    """Reads the sparse points of a COLMAP reconstruction; returns None if there is no file of points.

    Some programs write a `points3D.ply` in place of COLMAP's table; it is read if there is no table.

    Args:
        folder: Folder of the reconstruction.
        origin: World coordinates that the positions of the result are relative to.

    Raises:
        DatasetError: If the file is damaged or a point is not finite.
    """
    if not has_table(folder, "points3D"):
        cloud = folder / "points3D.ply"
        return read_point_cloud(cloud, origin) if cloud.is_file() else None
    positions, colors = _read(folder, "points3D", "read_points3d")
    positions = positions_from(positions, origin)
    if not np.isfinite(positions).all():
        raise DatasetError(f"{folder}: a point of points3D is not finite")
    return SparsePoints(positions, colors.astype(np.float32) / 255, origin)


def _read(folder: Path, table: str, function: str, suffixes: tuple[str, ...] = SUFFIXES):  # type: ignore[no-untyped-def]  # the return type depends on `function`
    """Reads a file of a reconstruction with the function of that name in `_colmap_binary` or `_colmap_text`.

    Args:
        folder: Folder of the reconstruction.
        table: Name of the file without suffix: `cameras`, `images` or `points3D`.
        function: Name of the function, such as `read_images`.
        suffixes: File name suffixes, preferred ones first.

    Raises:
        DatasetError: If the file is missing or cannot be read.
    """
    for suffix in suffixes:
        module = _colmap_binary if suffix == "bin" else _colmap_text
        path = folder / f"{table}.{suffix}"
        if path.is_file():
            try:
                return getattr(module, function)(path)
            except OSError as error:
                raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error
    raise DatasetError(f"{folder}: has neither {table}.bin nor {table}.txt")


def _viewmat(folder: Path, image: RawImage) -> np.ndarray:
    quaternion = np.array(image.quaternion, dtype=np.float64)
    largest = float(np.abs(quaternion).max())  # NaN quaternions fail the comparison below
    if not (1e-6 < largest < _MAX_POSE and np.isfinite(image.translation).all()):
        raise DatasetError(f"{folder}: the pose of image '{image.name}' is not finite")
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation_rows(*(quaternion / np.linalg.norm(quaternion)))
    viewmat[:3, 3] = image.translation
    return viewmat


def _intrinsics(folder: Path, camera: RawCamera) -> tuple[np.ndarray, LensModel]:
    """Returns the intrinsics (3, 3) and the lens distortion of a camera."""
    if camera.model not in _LENSES:
        raise DatasetError(
            f"{folder}: camera {camera.camera_id} is of the model {camera.model}, a panorama: cut the photos into "
            "perspective ones first, for example with COLMAP's `panorama_sfm.py`"
        )
    num_focals, create_lens = _LENSES[camera.model]
    fx, fy, (cx, cy) = (
        camera.parameters[0],
        camera.parameters[num_focals - 1],
        camera.parameters[num_focals : num_focals + 2],
    )
    distortion = camera.parameters[num_focals + 2 :]
    if not (np.abs(distortion) < _MAX_DISTORTION).all():
        raise DatasetError(f"{folder}: camera {camera.camera_id} has lens parameters that are no sensible numbers")
    return pinhole(fx, fy, cx, cy), create_lens(*distortion)
