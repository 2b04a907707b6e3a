"""Position, size and antialiasing of scenes.

Comparing them reveals that two files contain different scenes, or are drawn differently.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatwire.anchors.appearance import antialiased, origin_of
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
        antialiased: True if the scene is drawn antialiased (Mip-Splatting).
    """

    path: Path
    centre: Float64[np.ndarray, "3"]
    radius: float
    antialiased: bool = False

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
        radius = float(lower_median(np.linalg.norm(positions - middle, axis=1)))
        return cls(path, middle + origin_of(scene), radius, antialiased(scene))

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

    def drawing_difference(self, other: "SceneExtent") -> str | None:
        """Returns a message if only one of two scenes is drawn antialiased, else None."""
        if self.antialiased == other.antialiased:
            return None
        first, second = (self, other) if self.antialiased else (other, self)
        return antialiasing_message(first.path, second.path)

    def __str__(self) -> str:
        place = ", ".join(f"{value:.4g}" for value in self.centre)
        return f"centre ({place}) and radius {self.radius:.3g}"


def antialiasing_message(antialiased_file: Path, other: Path) -> str:
    """Returns a warning about a comparison of two scenes of which only one is drawn antialiased.

    Args:
        antialiased_file: File of the scene that is drawn antialiased.
        other: File of the other scene.
    """
    return (
        f"{antialiased_file} is drawn antialiased (Mip-Splatting) and {other} is not, so that their pictures differ; "
        "some formats and programs lose this property of a scene"
    )
