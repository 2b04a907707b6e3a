"""Sparse points of a reconstruction."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from splatwire.arguments import CheckedFields
from splatwire.errors import DatasetError
from splatwire.io.formats.ply_file import read_ply_elements

_AXES, _COLORS = ("x", "y", "z"), ("red", "green", "blue")
_GREY = 0.5


@dataclass(frozen=True, eq=False)
class SparsePoints(CheckedFields):
    """Points of a reconstruction.

    Attributes:
        positions: World coordinates.
        colors: RGB in [0, 1].
    """

    positions: Float[np.ndarray, "P 3"]
    colors: Float[np.ndarray, "P 3"]

    @property
    def num_points(self) -> int:
        """Number of points, P."""
        return int(self.positions.shape[0])


def read_point_cloud(path: Path) -> SparsePoints:
    """Reads the points of a PLY file, such as the one named by `ply_file_path` of a `transforms.json`.

    Colours are `red`, `green` and `blue`, bytes or floats in [0, 1]; points without colours are grey.

    Raises:
        DatasetError: If the file is not a PLY with vertices, or a point is not finite.
    """
    vertices = read_ply_elements(path).get("vertex")
    if vertices is None or not set(_AXES) <= set(vertices.names):
        raise DatasetError(f"{path}: has no vertices with {', '.join(_AXES)}")
    with np.errstate(over="ignore"):
        positions = np.stack([vertices.rows[axis].astype(np.float32) for axis in _AXES], axis=1)
    if not np.isfinite(positions).all():
        raise DatasetError(f"{path}: a point is not finite")
    colors = np.full(positions.shape, _GREY, dtype=np.float32)
    if set(_COLORS) <= set(vertices.names):
        columns = [vertices.rows[color] for color in _COLORS]
        full = 255 if all(column.dtype.kind in "iu" for column in columns) else 1
        colors = np.clip(np.stack(columns, axis=1).astype(np.float32) / full, 0, 1)
    return SparsePoints(positions, colors)
