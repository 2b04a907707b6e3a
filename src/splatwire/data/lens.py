"""Lens undistortion: converts photos to photos of an ideal pinhole camera."""

import functools
from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from splatwire.errors import DatasetError

_STEP = 1.01
_MAX_ZOOM = 2.0
_BORDER_SAMPLES, _INNER_SAMPLES = 129, 33
_CACHED = 4
_DERIVATIVE_STEP = 1e-5


class LensModel(ABC):
    """Base class of lens models. A lens model projects rays to the image plane."""

    least_zoom: ClassVar[float] = 1.0
    """Minimum ratio of the focal length after undistortion to that of the photo. Values below 1 keep more of the field
    of view and reduce the resolution of the centre. The default of 1 is for fisheye lenses, whose border a pinhole
    camera would stretch without bound."""

    @property
    def has_distortion(self) -> bool:
        """True if the lens differs from a pinhole."""
        return True

    @abstractmethod
    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion: returns the points where the lens images the rays (x, y, 1).

        The points are in the image plane at distance 1, before scaling by the focal length. Without distortion, the
        point of a ray is (x, y). Rays that the lens does not image give NaN.

        Args:
            x: First components of the rays.
            y: Second components of the rays, of the same shape.

        Returns:
            Coordinates x and y of the distorted points, of the same shape.
        """

    def stretch(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Returns the factor by which the lens enlarges a small area: the determinant of the Jacobian of `distort`.

        The factor is 0 or negative where the distortion folds the image, so that several rays reach the same point.
        """
        step = _DERIVATIVE_STEP * (1 + np.hypot(x, y))
        right, left = self.distort(x + step, y), self.distort(x - step, y)
        below, above = self.distort(x, y + step), self.distort(x, y - step)
        (xx, yx), (xy, yy) = ([a - b for a, b in zip(*pair, strict=True)] for pair in ((right, left), (below, above)))
        return np.asarray((xx * yy - xy * yx) / (4 * step * step))


@dataclass(frozen=True)
class Lens(LensModel):
    """Radial and tangential distortion as in OpenCV (`calib3d`, "pinhole camera model") and COLMAP's FULL_OPENCV.

    A ray (x, y, 1) hits the image at (x', y'). With r^2 = x^2 + y^2:

    * R = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    * x' = x R + 2 p1 x y + p2 (r^2 + 2 x^2)
    * y' = y R + p1 (r^2 + 2 y^2) + 2 p2 x y

    Attributes:
        k1: Radial coefficient of r^2.
        k2: Radial coefficient of r^4.
        p1: Tangential, vertical.
        p2: Tangential, horizontal.
        k3: Radial coefficient of r^6.
        k4: Radial coefficient of r^2 in the denominator.
        k5: Radial coefficient of r^4 in the denominator.
        k6: Radial coefficient of r^6 in the denominator.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    least_zoom: ClassVar[float] = 1 / _MAX_ZOOM

    @property
    def has_distortion(self) -> bool:
        """True if the lens differs from a pinhole."""
        return any(astuple(self))

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1."""
        square = x * x + y * y
        above, below = self._fraction(square)
        radial = above / below
        tangential_x = 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x)
        tangential_y = self.p1 * (square + 2 * y * y) + 2 * self.p2 * x * y
        return x * radial + tangential_x, y * radial + tangential_y

    def stretch(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Returns the factor by which the lens enlarges a small area: the determinant of the Jacobian of `distort`.

        The factor is 0 or negative where the distortion folds the image, so that several rays reach the same point.
        """
        square = x * x + y * y
        above, below = self._fraction(square)
        above_slope = self.k1 + square * (2 * self.k2 + 3 * self.k3 * square)
        below_slope = self.k4 + square * (2 * self.k5 + 3 * self.k6 * square)
        radial, growth = above / below, 2 * (above_slope - above / below * below_slope) / below
        xx = radial + growth * x * x + 2 * self.p1 * y + 6 * self.p2 * x
        yy = radial + growth * y * y + 6 * self.p1 * y + 2 * self.p2 * x
        xy = growth * x * y + 2 * self.p1 * x + 2 * self.p2 * y
        return np.where(below > 0, xx * yy - xy * xy, -1.0)

    def _fraction(self, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns numerator and denominator of the radial factor R of the distortion, given r^2."""
        above = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
        return above, 1 + square * (self.k4 + square * (self.k5 + square * self.k6))


NO_LENS = Lens()
"""Lens without distortion."""


@dataclass(frozen=True)
class Undistortion:
    """Mapping from a photo with lens distortion to the image of a pinhole camera of equal size.

    Attributes:
        lens: The lens model of the photo.
        photo_intrinsics: fx, fy, cx, cy of the photo, pixels; the centre of the top-left pixel is (0.5, 0.5).
        zoom: Ratio of the pinhole camera's focal lengths to those of the photo.
        width: Width of the photo and of the pinhole image, pixels.
        height: Height of the photo and of the pinhole image, pixels.
    """

    lens: LensModel
    photo_intrinsics: tuple[float, float, float, float]
    zoom: float
    width: int
    height: int

    @property
    def K(self) -> np.ndarray:  # noqa: N802  # the letter of every camera API
        """Intrinsics of the pinhole camera, float64 (3, 3)."""
        fx, fy, cx, cy = self.photo_intrinsics
        return np.array([[self.zoom * fx, 0, cx], [0, self.zoom * fy, cy], [0, 0, 1]])

    def image(self, photo: Float[np.ndarray, "H W C"]) -> Float[np.ndarray, "H W C"]:
        """Removes the lens distortion of a photo, with bicubic interpolation."""
        return np.clip(_sampled(photo, _grid(self), 3), 0, 1)

    def mask(self, mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
        """Removes the lens distortion of a mask, with nearest-neighbour interpolation."""
        return _sampled(mask[:, :, None], _grid(self), 0)[:, :, 0]


def undistortion_of(lens: LensModel, K: np.ndarray, width: int, height: int) -> Undistortion:
    """Finds the pinhole camera with the largest field of view whose whole image can be filled from the photo.

    Its zoom is at least `lens.least_zoom`.

    Args:
        lens: The lens.
        K: (3, 3) intrinsics of the photo, pixels.
        width: Width of the photo, pixels.
        height: Height of the photo, pixels.

    Raises:
        DatasetError: If the lens maps several rays to the same pixel, or its distortion leaves hardly any usable area.
    """
    photo_intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    zoom = 1.0
    if _is_covered(lens, photo_intrinsics, zoom, width, height):
        while zoom > lens.least_zoom and _is_covered(lens, photo_intrinsics, zoom / _STEP, width, height):
            zoom /= _STEP
    else:
        while zoom <= _MAX_ZOOM and not _is_covered(lens, photo_intrinsics, zoom, width, height):
            zoom *= _STEP
        if zoom > _MAX_ZOOM:
            raise DatasetError(
                f"the distortion of the lens is too large ({lens}); run `colmap image_undistorter` and use its output"
            )
    return Undistortion(lens, photo_intrinsics, zoom, width, height)


def _is_covered(lens: LensModel, photo_intrinsics: tuple[float, ...], zoom: float, width: int, height: int) -> bool:
    """True if an image without distortion can be computed from a photo at a given zoom.

    The image is that of a pinhole camera. Two conditions must hold: every pixel of the image has a point in the photo,
    and no point of the photo appears twice in the image.

    Args:
        lens: The lens.
        photo_intrinsics: fx, fy, cx, cy of the photo, pixels.
        zoom: Ratio of the focal length of the pinhole camera to that of the photo.
        width: Width of the photo and of the pinhole image, pixels.
        height: Height of the photo and of the pinhole image, pixels.
    """
    fx, fy, cx, cy = photo_intrinsics
    across, along = (np.linspace(0, size, _BORDER_SAMPLES) for size in (width, height))
    u = np.concatenate([across, across, np.zeros_like(along), np.full_like(along, width)])
    v = np.concatenate([np.zeros_like(across), np.full_like(across, height), along, along])
    x, y = lens.distort((u - cx) / (zoom * fx), (v - cy) / (zoom * fy))
    inside = (np.abs((fx * x + cx) / width - 0.5) <= 0.5).all() and (np.abs((fy * y + cy) / height - 0.5) <= 0.5).all()
    columns, rows = (np.linspace(0, size, _INNER_SAMPLES) for size in (width, height))
    grid_x, grid_y = np.meshgrid((columns - cx) / (zoom * fx), (rows - cy) / (zoom * fy))
    return bool(inside and (lens.stretch(grid_x, grid_y) > 0).all())


@functools.lru_cache(_CACHED)
def _grid(view: Undistortion) -> Float[np.ndarray, "2 H W"]:
    """Returns the position (row and column) of each pixel of the pinhole image in the distorted photo."""
    fx, fy, cx, cy = view.photo_intrinsics
    rays_x = (np.arange(view.width) + 0.5 - cx) / (view.zoom * fx)
    rays_y = (np.arange(view.height) + 0.5 - cy) / (view.zoom * fy)
    x, y = view.lens.distort(*np.meshgrid(rays_x, rays_y))
    return np.stack([fy * y + cy - 0.5, fx * x + cx - 0.5]).astype(np.float32)


def _sampled(pixels: np.ndarray, grid: Float[np.ndarray, "2 H W"], order: int) -> np.ndarray:
    """Resamples an image (H, W, C) at fractional pixel positions, by spline interpolation of the given order."""
    from scipy.ndimage import map_coordinates  # takes long to load

    planes = [map_coordinates(plane, grid, order=order, mode="nearest") for plane in np.moveaxis(pixels, 2, 0)]
    return np.stack(planes, axis=2)
