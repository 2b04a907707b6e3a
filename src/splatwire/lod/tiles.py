"""Layout of the tiles of levels of detail."""

from dataclasses import dataclass

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import SceneStream
from splatwire.bitstream.limits import MAX_TIERS
from splatwire.bitstream.tiles import Tiles, read_tiles

FACTOR = 8
"""Approximate reduction of the number of Gaussians from level to level."""


@dataclass(frozen=True)
class LevelShape:
    """Numbers of Gaussians in one level of detail and in each of its tiles.

    Attributes:
        count: Number of Gaussians of the level.
        size: Number of Gaussians per tile; the last tile may have fewer.
    """

    count: int
    size: int

    @property
    def num_tiles(self) -> int:
        """Number of tiles of this level of detail."""
        return -(-self.count // self.size)

    @property
    def edges(self) -> np.ndarray:
        """Index, within this level of detail, of the first Gaussian of each tile, int64 (tiles + 1).

        The last entry is the number of Gaussians of the level.
        """
        return np.minimum(np.arange(self.num_tiles + 1) * self.size, self.count).astype(np.int64)


def level_shapes(count: int, tile: int) -> tuple[LevelShape, ...]:
    """Returns the sizes of all levels of detail of a scene, finest level first.

    Args:
        count: Number of Gaussians, above 0.
        tile: Maximum number of Gaussians per tile.
    """
    shapes = [_even(count, tile)]
    while shapes[-1].count > 1 and len(shapes) < MAX_TIERS and (len(shapes) < 2 or shapes[-1].num_tiles > 1):
        parents = -(-shapes[-1].num_tiles // FACTOR)
        size = -(-shapes[-1].count // (FACTOR * parents))
        shapes.append(LevelShape(parents * size, size))
    return tuple(shapes)


def _even(count: int, tile: int) -> LevelShape:
    return LevelShape(count, -(-count // -(-count // tile)))


@checked
def tiles_of(stream: SceneStream) -> Tiles:
    """Returns the tiles of a stream with levels of detail; packets may be missing.

    Raises:
        BitstreamError: If the stream has no tile index, or its side information is damaged.
    """
    return read_tiles(stream.manifest, stream.side_info)
