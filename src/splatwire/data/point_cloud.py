"""Sparse points of a reconstruction."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from splatwire.arguments import CheckedFields
from splatwire.errors import DatasetError
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.reprs import summary_repr
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin

_AXES, _COLORS = ("x", "y", "z"), ("red", "green", "blue")
_GREY = 0.5


@dataclass(frozen=True, eq=False)
class SparsePoints(CheckedFields):
    """Points of a reconstruction.

    Attributes:
        positions: Positions relative to `origin`, world units.
        colors: RGB in [0, 1].
        origin: World coordinates that the positions are relative to.
    """

    positions: Float[np.ndarray, "P 3"]
    colors: Float[np.ndarray, "P 3"]
    origin: Origin = NO_ORIGIN

    __repr__ = summary_repr

    @property
    def num_points(self) -> int:
        """Number of points, P."""
        return int(self.positions.shape[0])

    def relative_to(self, origin: Origin) -> "SparsePoints":
        """Returns the points with positions relative to a different origin.

        Raises:
            InvalidValueError: If the origin is not three finite numbers.
        """
        origin = check_origin(origin)
        if origin == self.origin:
            return self
        moved = self.positions.astype(np.float64) + (np.array(self.origin) - np.array(origin))
        return replace(self, positions=moved.astype(self.positions.dtype), origin=origin)


def positions_from(world: np.ndarray, origin: Origin) -> np.ndarray:
    """Returns positions relative to an origin, float32 (P, 3); numbers beyond the range of float32 become infinite.

    Args:
        world: World coordinates, float (P, 3).
        origin: World coordinates of the origin.
    """
    with np.errstate(over="ignore"):
        return (world.astype(np.float64) - np.array(origin)).astype(np.float32)


def read_point_cloud(path: Path, origin: Origin = NO_ORIGIN) -> SparsePoints:
    """Reads the points of a PLY file, such as the one named by `ply_file_path` of a `transforms.json`.

    Colours are `red`, `green` and `blue`, bytes or floats in [0, 1]; points without colours are grey.

    Args:
        path: The file, with positions in world coordinates.
        origin: World coordinates that the positions of the result are relative to.

    Raises:
        DatasetError: If the file is not a PLY with vertices, or a point is not finite.
    """
    vertices = read_ply_elements(path).get("vertex")
    if vertices is None or not set(_AXES) <= set(vertices.names):
        raise DatasetError(f"{path}: has no vertices with {', '.join(_AXES)}")
    positions = positions_from(vertices.select_float64(list(_AXES)), origin)
    if not np.isfinite(positions).all():
        raise DatasetError(f"{path}: a point is not finite")
    colors = np.full(positions.shape, _GREY, dtype=np.float32)
    if set(_COLORS) <= set(vertices.names):
        columns = [vertices.rows[color] for color in _COLORS]
        full = 255 if all(column.dtype.kind in "iu" for column in columns) else 1
        colors = np.clip(np.stack(columns, axis=1).astype(np.float32) / full, 0, 1)
    return SparsePoints(positions, colors, origin)
