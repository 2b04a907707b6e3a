"""How levels are cut into tiles: blocks of a stream's levels, each of which stands for some of the next finer level."""

from dataclasses import dataclass

import numpy as np

from splatwire.packets import SceneStream
from splatwire.packets.limits import MAX_TIERS
from splatwire.packets.tiles import Tiles, read_tiles

FACTOR = 8
"""Gaussians that one of the next coarser level stands for, about."""


@dataclass(frozen=True)
class LevelShape:
    """How a level is cut into tiles; see `spans_of`.

    Attributes:
        count: Gaussians.
        size: Of each tile; the last one may have fewer.
    """

    count: int
    size: int

    @property
    def num_tiles(self) -> int:
        """Tiles."""
        return -(-self.count // self.size)

    @property
    def edges(self) -> np.ndarray:
        """Where tiles begin and the last one ends, int64 (tiles + 1)."""
        return np.minimum(np.arange(self.num_tiles + 1) * self.size, self.count).astype(np.int64)


def level_shapes(count: int, tile: int) -> tuple[LevelShape, ...]:
    """Levels of a scene, the finest first, each with an eighth of the Gaussians, until one is a single tile.

    Args:
        count: Gaussians of the scene, above 0.
        tile: Most Gaussians of a tile.
    """
    shapes = [_even(count, tile)]
    while shapes[-1].count > 1 and len(shapes) < MAX_TIERS and (len(shapes) < 2 or shapes[-1].num_tiles > 1):
        parents = -(-shapes[-1].num_tiles // FACTOR)
        size = -(-shapes[-1].count // (FACTOR * parents))
        shapes.append(LevelShape(parents * size, size))
    return tuple(shapes)


def _even(count: int, tile: int) -> LevelShape:
    return LevelShape(count, -(-count // -(-count // tile)))


def tiles_of(stream: SceneStream) -> Tiles:
    """The tiles of a stream with levels, of which packets may be missing.

    Raises:
        BitstreamError: If it has no index of tiles, or its side information is damaged.
    """
    return read_tiles(stream.manifest, stream.side_info)
