"""Bounding sphere of nearly all Gaussians in all frames of a sequence, for the initial camera."""

from dataclasses import dataclass

import numpy as np

from splatwire.ops.arrays import lower_median
from splatwire.types.splats import Splats

SAMPLES = 6000
FAINT = 0.1
"""Opacity below which Gaussians do not count for the extent."""
NEARLY_ALL, MAX_DISTANCE_OCTAVES = 0.998, 5.0
"""Fraction of Gaussians inside the sphere of a frame, and its maximum radius in median distances from the centre."""


@dataclass(frozen=True)
class BoundingSphere:
    """Sphere that contains nearly all Gaussians of one or more frames.

    Attributes:
        middle: Centre, float64 (3), world units.
        radius: Radius, world units.
    """

    middle: np.ndarray
    radius: float

    def union(self, other: "BoundingSphere") -> "BoundingSphere":
        """Returns the smallest sphere that contains two spheres."""
        apart = float(np.linalg.norm(other.middle - self.middle))
        if apart + other.radius <= self.radius:
            return self
        if apart + self.radius <= other.radius:
            return other
        radius = (apart + self.radius + other.radius) / 2
        return BoundingSphere(self.middle + (other.middle - self.middle) * ((radius - self.radius) / apart), radius)


def bounding_sphere(splats: Splats) -> BoundingSphere | None:
    """Returns a sphere around nearly all Gaussians; None without Gaussians."""
    if not splats.num_gaussians:
        return None
    few = slice(None, None, -(-splats.num_gaussians // SAMPLES))
    means, seen = splats.means[few].astype(np.float64), splats.opacities[few] >= FAINT
    return sphere_around(means[seen] if bool(seen.any()) else means)


def sphere_around(positions: np.ndarray) -> BoundingSphere:
    """Returns a sphere around nearly all points, centred at their median.

    Args:
        positions: The points, (n, 3), at least one.
    """
    middle = lower_median(positions)
    away = np.linalg.norm(positions - middle, axis=1)
    last = np.sort(away)[int(np.ceil(NEARLY_ALL * len(away))) - 1]
    return BoundingSphere(middle.astype(np.float64), min(float(last), MAX_DISTANCE_OCTAVES * float(lower_median(away))))
