"""Bounding sphere of nearly all Gaussians in all frames of a sequence, for the initial camera."""

from dataclasses import dataclass

import numpy as np

from splatwire.ops.arrays import lower_median
from splatwire.types.splats import Splats

SAMPLE_SIZE = 6000
MIN_FRAMED_OPACITY = 0.1
"""Opacity below which Gaussians do not count for the extent."""
INSIDE_SHARE, MAX_MEDIAN_DISTANCES = 0.998, 5.0
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
        distance = float(np.linalg.norm(other.middle - self.middle))
        if distance + other.radius <= self.radius:
            return self
        if distance + self.radius <= other.radius:
            return other
        radius = (distance + self.radius + other.radius) / 2
        return BoundingSphere(self.middle + (other.middle - self.middle) * ((radius - self.radius) / distance), radius)


def bounding_sphere(splats: Splats) -> BoundingSphere | None:
    """Returns a sphere around nearly all Gaussians; None without Gaussians."""
    if not splats.num_gaussians:
        return None
    sample = slice(None, None, -(-splats.num_gaussians // SAMPLE_SIZE))
    means, visible = splats.means[sample].astype(np.float64), splats.opacities[sample] >= MIN_FRAMED_OPACITY
    return sphere_around(means[visible] if bool(visible.any()) else means)


def sphere_around(positions: np.ndarray) -> BoundingSphere:
    """Returns a sphere around nearly all points, centred at their median.

    Args:
        positions: The points, (n, 3), at least one.
    """
    middle = lower_median(positions)
    distances = np.linalg.norm(positions - middle, axis=1)
    radius = np.sort(distances)[int(np.ceil(INSIDE_SHARE * len(distances))) - 1]
    return BoundingSphere(
        middle.astype(np.float64), min(float(radius), MAX_MEDIAN_DISTANCES * float(lower_median(distances)))
    )
