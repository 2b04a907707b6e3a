"""Selects the tiles to draw and to request for a viewpoint."""

from dataclasses import dataclass, replace

import numpy as np

from splatwire.arguments import CheckedFields, array_of, checked
from splatwire.bitstream.tiles import Tiles
from splatwire.reprs import summary_repr

# `web/src/codec/levels/cut.ts` implements the same selection.
BUDGET = 1_000_000
"""Default maximum number of Gaussians to draw."""
MIN_SCREEN_ERROR = 0.48
"""Largest acceptable screen error of centres, pixels. Tiles with a smaller error are not refined."""
OUTSIDE_WEIGHT = 0.05
"""Factor of the error of tiles outside the picture; above 0, because the camera may soon show them."""
MIN_DISTANCE_RATIO = 0.02
"""Smallest assumed distance between camera and tile, as a fraction of the tile's diagonal."""
_PAIRS = 1 << 20
"""Number of pairs of a Gaussian and a tile that are compared at once; limits memory."""


@dataclass(frozen=True, eq=False)
class Viewpoint(CheckedFields):
    """Camera for which tiles of a scene with levels of detail are selected.

    Attributes:
        viewmat: World-to-camera transform; x right, y down, z ahead; float64 (4, 4).
        focal: Focal length, pixels.
        width: Picture width, pixels.
        height: Picture height, pixels.
        origin: World coordinates of the point that `viewmat` is relative to.
    """

    viewmat: np.ndarray
    focal: float
    width: int
    height: int
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    __repr__ = summary_repr

    def relative_to(self, origin: tuple[float, float, float]) -> "Viewpoint":
        """Returns the viewpoint with coordinates relative to a different origin."""
        if origin == self.origin:
            return self
        viewmat = np.array(self.viewmat, dtype=np.float64)
        viewmat[:3, 3] += viewmat[:3, :3] @ (np.array(origin) - np.array(self.origin))
        return replace(self, viewmat=viewmat, origin=origin)


@dataclass(frozen=True)
class Cut(CheckedFields):
    """Tiles to draw and tiles to request for a viewpoint.

    Attributes:
        drawn: Received tiles to draw.
        wanted: Tiles to request, most useful first.
    """

    drawn: tuple[int, ...]
    wanted: tuple[int, ...]


def pixel_errors(tiles: Tiles, viewpoint: Viewpoint | None) -> np.ndarray:
    """Returns the screen-space error of each tile, pixels, float64 (B).

    The screen-space error of a tile is the error of a picture that shows the next coarser tile in its place. Tiles of
    the coarsest level of detail have an infinite error. The errors of tiles outside the picture are reduced.

    Args:
        tiles: All tiles of the scene.
        viewpoint: Viewpoint; None for errors in world units instead of pixels.
    """
    return _errors_and_usefulness(tiles, viewpoint)[0]


def _errors_and_usefulness(tiles: Tiles, viewpoint: Viewpoint | None) -> tuple[np.ndarray, np.ndarray]:
    """Returns the screen-space error (`pixel_errors`) and the usefulness of each tile, float64 (B) each.

    Usefulness is the area of the tile's bounding box in the picture, divided by the size of the tile in bytes. It is
    reduced for tiles outside the picture, and infinite for tiles of the coarsest level of detail. Without a viewpoint,
    the usefulness equals the error.
    """
    errors = np.where(tiles.parents < 0, np.inf, tiles.errors[tiles.parents])
    if viewpoint is None:
        return errors, errors.copy()
    distance, seen, covered = _project_boxes(tiles, viewpoint)
    counts = np.where(seen, 1.0, OUTSIDE_WEIGHT)
    useful = np.where(tiles.parents < 0, np.inf, covered * counts / np.maximum(tiles.sizes, 1))
    return errors * viewpoint.focal / distance * counts, useful


def _project_boxes(tiles: Tiles, viewpoint: Viewpoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Projects the bounding boxes of tiles into the picture.

    Returns:
        Distance of each box from the camera; mask of visible boxes; and area of each box, square pixels.
    """
    middle, half = (tiles.low + tiles.high) / 2, (tiles.high - tiles.low) / 2
    eye = np.array(
        [-sum(viewpoint.viewmat[row, axis] * viewpoint.viewmat[row, 3] for row in range(3)) for axis in range(3)]
    )
    outside = np.maximum(np.abs(eye - middle) - half, 0)
    distance = np.maximum(_length(outside), np.maximum(2 * MIN_DISTANCE_RATIO * _length(half), 1e-9))
    # Written out, so that every language adds in the same order.
    center = [
        row[0] * middle[:, 0] + row[1] * middle[:, 1] + row[2] * middle[:, 2] + row[3] for row in viewpoint.viewmat[:3]
    ]
    reach = [
        abs(row[0]) * half[:, 0] + abs(row[1]) * half[:, 1] + abs(row[2]) * half[:, 2] for row in viewpoint.viewmat[:3]
    ]
    near = np.maximum(center[2] - reach[2], distance)
    far = np.maximum(center[2] + reach[2], near)
    seen, rectangle = center[2] + reach[2] > 0, np.ones(tiles.num_tiles)
    for axis, edge in enumerate((viewpoint.width / 2 / viewpoint.focal, viewpoint.height / 2 / viewpoint.focal)):
        low, high = center[axis] - reach[axis], center[axis] + reach[axis]
        low, high = low / np.where(low < 0, near, far), high / np.where(high < 0, far, near)
        extent = np.minimum(high, edge) - np.maximum(low, -edge)
        seen &= extent > 0
        rectangle = rectangle * extent * viewpoint.focal
    a, b, c = half.T
    scale = viewpoint.focal / distance
    anywhere = np.minimum(2 * (a * b + b * c + c * a) * scale * scale, float(viewpoint.width * viewpoint.height))
    return distance, seen, np.where(seen, rectangle, anywhere)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Returns the Euclidean length of each row, (N, 3) to (N)."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


@checked
def cut_of(tiles: Tiles, received: np.ndarray, viewpoint: Viewpoint | None, budget: int = BUDGET) -> Cut:
    """Selects the tiles to draw and to request for a viewpoint.

    Args:
        tiles: The tiles.
        received: Mask of received tiles, bool (B).
        viewpoint: Viewpoint; None refines the whole scene from coarse to fine.
        budget: Maximum number of Gaussians to draw.
    """
    received = array_of(received, "received", (tiles.num_tiles,), "b")
    chosen = _chosen(tiles, viewpoint, budget)
    real = np.zeros(tiles.num_tiles, dtype=bool)
    real[chosen] = received[chosen]
    for level in range(int(tiles.levels.max(initial=0)) - 1, -1, -1):
        of_level = np.flatnonzero((tiles.levels == level) & (tiles.parents >= 0))
        real[of_level] &= real[tiles.parents[of_level]]
    return Cut(tuple(np.flatnonzero(real).tolist()), tuple(chosen[~received[chosen]].tolist()))


def _chosen(tiles: Tiles, viewpoint: Viewpoint | None, budget: int) -> np.ndarray:
    """Returns the indices of the tiles that are needed for a viewpoint, most useful first.

    A tile is not needed where the next coarser tile is precise enough.

    Args:
        tiles: All tiles of the scene.
        viewpoint: The viewpoint; None to refine the whole scene.
        budget: Maximum number of Gaussians in the selected tiles. Tiles of the coarsest level of detail may exceed it.
    """
    errors, useful = _errors_and_usefulness(tiles, viewpoint)
    for level in range(int(tiles.levels.max(initial=0)) - 1, -1, -1):
        of_level = np.flatnonzero((tiles.levels == level) & (tiles.parents >= 0))
        for values in (errors, useful):
            values[of_level] = np.minimum(values[of_level], values[tiles.parents[of_level]])
    candidates = np.flatnonzero(errors > (MIN_SCREEN_ERROR if viewpoint is not None else 0.0))
    order = candidates[np.argsort(-useful[candidates], kind="stable")]
    over = np.flatnonzero((np.cumsum(tiles.counts[order]) > budget) & (tiles.parents[order] >= 0))
    return order[: over[0]] if len(over) else order


def finer_tile_of(tiles: Tiles, tile: int, means: np.ndarray) -> np.ndarray:
    """Returns, for each Gaussian of a coarser tile, the finer tile at its position.

    Args:
        tiles: The tiles.
        tile: Index of the coarser tile.
        means: Centres of some Gaussians of this tile, float64 (N, 3).

    Returns:
        Index of the finer tile with the nearest bounding box, int64 (N); -1 if `tile` is in the finest level of detail.
    """
    finer = np.flatnonzero(tiles.parents == tile)
    if not len(finer):
        return np.full(len(means), -1, dtype=np.int64)
    low, high = tiles.low[finer][:, None], tiles.high[finer][:, None]
    children, rows = np.empty(len(means), dtype=np.int64), max(1, _PAIRS // len(finer))
    for begin in range(0, len(means), rows):  # a tile may have thousands of children
        piece = means[begin : begin + rows]
        outside = np.maximum(np.maximum(low - piece, piece - high), 0)
        children[begin : begin + rows] = finer[outside.max(axis=2).argmin(axis=0)]
    return children
