"""Wide-angle lens models as defined by COLMAP and OpenCV (COLMAP, "Camera Models"; OpenCV, `fisheye`)."""

from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np

from splatwire.data.lens import LensModel


@dataclass(frozen=True)
class FisheyeLens(LensModel):
    """Fisheye lens: equidistant projection with a polynomial.

    COLMAP's OPENCV_FISHEYE, and its models with fewer terms, are special cases.

    A ray at angle t to the axis hits the image at distance t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) from the centre,
    plus the tangential and thin-prism terms of THIN_PRISM_FISHEYE.

    Attributes:
        k1: Radial coefficient of t^2.
        k2: Radial coefficient of t^4.
        k3: Radial coefficient of t^6.
        k4: Radial coefficient of t^8.
        p1: Tangential, vertical.
        p2: Tangential, horizontal.
        sx1: Thin prism, horizontal.
        sy1: Thin prism, vertical.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    sx1: float = 0.0
    sy1: float = 0.0

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1."""
        u, v = _equidistant(x, y)
        square = u * u + v * v
        radial = 1 + square * (self.k1 + square * (self.k2 + square * (self.k3 + square * self.k4)))
        distorted_u = u * radial + 2 * self.p1 * u * v + self.p2 * (square + 2 * u * u) + self.sx1 * square
        distorted_v = v * radial + 2 * self.p2 * u * v + self.p1 * (square + 2 * v * v) + self.sy1 * square
        return distorted_u, distorted_v


@dataclass(frozen=True)
class RadTanThinPrismLens(LensModel):
    """COLMAP's RAD_TAN_THIN_PRISM_FISHEYE, the model of Project Aria ("Fisheye62" with thin prism).

    Attributes:
        k0: Radial coefficient of the angle to the power 2.
        k1: Radial coefficient, power 4.
        k2: Radial coefficient, power 6.
        k3: Radial coefficient, power 8.
        k4: Radial coefficient, power 10.
        k5: Radial coefficient, power 12.
        p0: Tangential, horizontal.
        p1: Tangential, vertical.
        s0: Thin prism, horizontal, power 2 of the distorted radius.
        s1: Thin prism, horizontal, power 4.
        s2: Thin prism, vertical, power 2.
        s3: Thin prism, vertical, power 4.
    """

    k0: float
    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    p0: float
    p1: float
    s0: float
    s1: float
    s2: float
    s3: float

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1."""
        u, v = _equidistant(x, y)
        angle = u * u + v * v
        radial = np.polynomial.polynomial.polyval(angle, (1.0, *astuple(self)[:6]))
        u, v = u * radial, v * radial
        square = u * u + v * v
        distorted_u = u + 2 * self.p1 * u * v + self.p0 * (square + 2 * u * u) + square * (self.s0 + self.s1 * square)
        distorted_v = v + 2 * self.p0 * u * v + self.p1 * (square + 2 * v * v) + square * (self.s2 + self.s3 * square)
        return distorted_u, distorted_v


@dataclass(frozen=True)
class FovLens(LensModel):
    """Wide-angle lens, COLMAP's model FOV (Devernay and Faugeras 2001): r' = atan(2 r tan(omega / 2)) / omega.

    A ray (x, y, 1) with r^2 = x^2 + y^2 hits the image at distance r' from the centre.

    Attributes:
        omega: Field of view of the ideal lens, radians.
    """

    omega: float

    @property
    def has_distortion(self) -> bool:
        """True if the lens has distortion."""
        return abs(self.omega) >= 1e-3

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1."""
        radius, wide = np.hypot(x, y), 2 * np.tan(self.omega / 2)
        safe = np.maximum(radius, 1e-12)
        factor = np.where(radius > 1e-9, np.arctan(safe * wide) / (safe * self.omega), wide / self.omega)
        return x * factor, y * factor


@dataclass(frozen=True)
class DivisionLens(LensModel):
    """Lens with radial distortion, COLMAP's model DIVISION (Fitzgibbon 2001).

    The image point (x', y') is hit by the ray (x', y', 1 + k r'^2), with r'^2 = x'^2 + y'^2.

    Attributes:
        k: Coefficient of the squared distorted radius.
    """

    k: float
    least_zoom: ClassVar[float] = 0.5

    @property
    def has_distortion(self) -> bool:
        """True if the lens has distortion."""
        return self.k != 0

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1.

        Rays that the lens does not image give NaN.
        """
        with np.errstate(invalid="ignore"):
            factor = 2 / (1 + np.sqrt(1 - 4 * self.k * (x * x + y * y)))
        return x * factor, y * factor


@dataclass(frozen=True)
class EucmLens(LensModel):
    """COLMAP's EUCM, the enhanced unified camera model (Khomutenko, Garcia and Martinet 2016).

    Attributes:
        alpha: Weight of the sphere in the projection, 0 to 1.
        beta: Shape of the ellipsoid, positive.
    """

    alpha: float
    beta: float

    @property
    def has_distortion(self) -> bool:
        """True if the lens has distortion."""
        return self.alpha != 0

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applies the lens distortion to rays (x, y, 1); returns points of the image plane at distance 1.

        Rays that the lens does not image give NaN.
        """
        with np.errstate(invalid="ignore"):
            depth = self.alpha * np.sqrt(self.beta * (x * x + y * y) + 1) + 1 - self.alpha
            depth = np.where(depth > 0, depth, np.nan)
        return x / depth, y / depth


def _equidistant(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales rays (x, y, 1) to the equidistant projection.

    The length of (x, y) becomes the angle between ray and optical axis in radians.
    """
    radius = np.hypot(x, y)
    safe = np.maximum(radius, 1e-12)
    factor = np.where(radius > 1e-9, np.arctan(safe) / safe, 1.0)
    return x * factor, y * factor
