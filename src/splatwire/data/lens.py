"""Lenses that bend rays: what photos through them look like to a pinhole camera."""

import functools
from dataclasses import astuple, dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.errors import DatasetError

_STEP = 1.01
_MOST_ZOOM = 2.0
_BORDER_SAMPLES, _INNER_SAMPLES = 129, 33
_CACHED = 4


@dataclass(frozen=True)
class Lens:
    """Radial and tangential distortion as in OpenCV (`calib3d`, "pinhole camera model") and COLMAP's model OPENCV.

    A ray (x, y, 1) with r^2 = x^2 + y^2 meets the picture where the undistorted ray (x', y', 1) would:
    x' = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2),
    y' = y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y.

    Attributes:
        k1: Radial, of the second power.
        k2: Radial, of the fourth power.
        p1: Tangential, vertical.
        p2: Tangential, horizontal.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def bends(self) -> bool:
        """Whether it does anything."""
        return any(astuple(self))

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where rays (x, y, 1) meet the picture plane at distance 1."""
        square = x * x + y * y
        radial = 1 + square * (self.k1 + self.k2 * square)
        tangential_x = 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x)
        tangential_y = self.p1 * (square + 2 * y * y) + 2 * self.p2 * x * y
        return x * radial + tangential_x, y * radial + tangential_y

    def stretch(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Determinant of the derivative of `distort`: where it is not positive, the picture is folded."""
        square = x * x + y * y
        radial, growth = 1 + square * (self.k1 + self.k2 * square), 2 * (self.k1 + 2 * self.k2 * square)
        xx = radial + growth * x * x + 2 * self.p1 * y + 6 * self.p2 * x
        yy = radial + growth * y * y + 6 * self.p1 * y + 2 * self.p2 * x
        xy = growth * x * y + 2 * self.p1 * x + 2 * self.p2 * y
        return np.asarray(xx * yy - xy * xy)


NO_LENS = Lens()
"""Bends nothing."""


@dataclass(frozen=True)
class Undistortion:
    """From a photo through a lens to that of a pinhole camera of the same size.

    Attributes:
        lens: The lens.
        photo: fx, fy, cx, cy of the photo, pixels; the centre of the top-left pixel is (0.5, 0.5).
        zoom: Factor on fx and fy of the pinhole camera, whose picture no pixel lies outside the photo.
        width: Of both, pixels.
        height: Of both, pixels.
    """

    lens: Lens
    photo: tuple[float, float, float, float]
    zoom: float
    width: int
    height: int

    @property
    def K(self) -> np.ndarray:  # noqa: N802  # the letter of every camera API
        """Intrinsics of the pinhole camera, float64 (3, 3)."""
        fx, fy, cx, cy = self.photo
        return np.array([[self.zoom * fx, 0, cx], [0, self.zoom * fy, cy], [0, 0, 1]])

    def image(self, photo: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
        """What a pinhole camera would have seen: bicubic between the photo's pixels."""
        return _sampled(photo, _grid(self), "bicubic").clamp(0, 1)

    def mask(self, mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
        """The mask of a photo, for that picture: the nearest pixel's."""
        return _sampled(mask[:, :, None].float(), _grid(self), "nearest")[:, :, 0] > 0.5


def undistortion(lens: Lens, K: np.ndarray, width: int, height: int) -> Undistortion:
    """The pinhole camera that sees as much of a photo as fills its picture.

    Args:
        lens: The lens.
        K: (3, 3) intrinsics of the photo, pixels.
        width: Its width.
        height: Its height.

    Raises:
        DatasetError: If the lens folds the picture, or bends so much that hardly anything would be left.
    """
    photo = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    zoom = 1.0
    if _fits(lens, photo, zoom, width, height):
        while zoom > 1 / _MOST_ZOOM and _fits(lens, photo, zoom / _STEP, width, height):
            zoom /= _STEP
    else:
        while zoom <= _MOST_ZOOM and not _fits(lens, photo, zoom, width, height):
            zoom *= _STEP
        if zoom > _MOST_ZOOM:
            raise DatasetError(
                f"the lens bends too much (k1 {lens.k1:g}, k2 {lens.k2:g}, p1 {lens.p1:g}, p2 {lens.p2:g}); "
                "run `colmap image_undistorter` and use its output folder"
            )
    return Undistortion(lens, photo, zoom, width, height)


def _fits(lens: Lens, photo: tuple[float, ...], zoom: float, width: int, height: int) -> bool:
    """Whether every pixel of the pinhole camera's picture lies in the photo, and none is folded over another."""
    fx, fy, cx, cy = photo
    across, along = (np.linspace(0, size, _BORDER_SAMPLES) for size in (width, height))
    u = np.concatenate([across, across, np.zeros_like(along), np.full_like(along, width)])
    v = np.concatenate([np.zeros_like(across), np.full_like(across, height), along, along])
    x, y = lens.distort((u - cx) / (zoom * fx), (v - cy) / (zoom * fy))
    inside = (np.abs((fx * x + cx) / width - 0.5) <= 0.5).all() and (np.abs((fy * y + cy) / height - 0.5) <= 0.5).all()
    columns, rows = (np.linspace(0, size, _INNER_SAMPLES) for size in (width, height))
    grid_x, grid_y = np.meshgrid((columns - cx) / (zoom * fx), (rows - cy) / (zoom * fy))
    return bool(inside and (lens.stretch(grid_x, grid_y) > 0).all())


@functools.lru_cache(_CACHED)
def _grid(view: Undistortion) -> Float[Tensor, "1 H W 2"]:
    """Where each pixel of the pinhole camera's picture lies in the photo, in `grid_sample`'s units of -1 to 1."""
    fx, fy, cx, cy = view.photo
    rays_x = (np.arange(view.width) + 0.5 - cx) / (view.zoom * fx)
    rays_y = (np.arange(view.height) + 0.5 - cy) / (view.zoom * fy)
    x, y = view.lens.distort(*np.meshgrid(rays_x, rays_y))
    grid = np.stack([2 * (fx * x + cx) / view.width - 1, 2 * (fy * y + cy) / view.height - 1], axis=-1)
    return torch.from_numpy(grid[None].astype(np.float32))


def _sampled(pixels: Float[Tensor, "H W C"], grid: Float[Tensor, "1 H W 2"], mode: str) -> Float[Tensor, "H W C"]:
    planes = pixels.permute(2, 0, 1)[None]
    found = torch.nn.functional.grid_sample(planes, grid, mode=mode, padding_mode="border", align_corners=False)
    return found[0].permute(1, 2, 0).contiguous()
