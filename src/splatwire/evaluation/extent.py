"""Position and size of scenes. Comparing them reveals that two files contain different scenes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatwire.anchors.appearance import origin_of
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import lower_median, to_numpy
from splatwire.types.scene import Scene

FARTHEST, MAX_RADIUS_RATIO = 2.0, 4.0
"""Limits beyond which files contain different scenes: distance of the centres in radii of the larger scene, and ratio
of the radii."""


@dataclass(frozen=True, eq=False)
class SceneExtent:
    """Position and size of a scene.

    Attributes:
        path: File of the scene.
        centre: Median position, world coordinates.
        radius: Median distance of the elements from the centre, world units.
    """

    path: Path
    centre: Float64[np.ndarray, "3"]
    radius: float

    @classmethod
    def of(cls, scene: Scene, path: Path) -> "SceneExtent":
        """Measures position and size of a scene.

        Raises:
            InvalidValueError: If the scene has no elements.
        """
        positions = to_numpy(scene.positions).astype(np.float64)
        if not len(positions):
            raise InvalidValueError(f"{path} has no {scene.ELEMENTS}: there is nothing to compare")
        middle = lower_median(positions)
        return cls(path, middle + origin_of(scene), float(lower_median(np.linalg.norm(positions - middle, axis=1))))

    def difference(self, other: "SceneExtent") -> str | None:
        """Returns a message if two scenes differ strongly in position or size, else None."""
        small, large = min(self.radius, other.radius), max(self.radius, other.radius)
        away = float(np.linalg.norm(other.centre - self.centre))
        # A radius of 0, as of a single Gaussian, is no measure of a scene.
        if not ((large > 0 and away > FARTHEST * large) or (small > 0 and large > MAX_RADIUS_RATIO * small)):
            return None
        return (
            f"{other.path} is of another scene than {self.path}: {other} instead of {self} (median position and "
            "distance from it)"
        )

    def __str__(self) -> str:
        place = ", ".join(f"{value:.4g}" for value in self.centre)
        return f"centre ({place}) and radius {self.radius:.3g}"
