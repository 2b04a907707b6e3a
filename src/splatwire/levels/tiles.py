"""Which tiles there are: blocks of a stream's levels, each of which stands for some of the next finer level."""

import itertools
from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.decoder import open_side_info
from splatwire.packets import SceneStream
from splatwire.packets.limits import MAX_TIERS
from splatwire.packets.tile_index import read_tile_index

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


def parents_of(children: int, parents: int) -> np.ndarray:
    """The coarser tile that stands for each of some finer ones, int64 (children): about equally many for each."""
    return ((2 * np.arange(children, dtype=np.int64) + 1) * parents) // (2 * children)


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of a scene, by their block in the stream: those of the coarsest level first.

    Attributes:
        levels: Level of each, 0 for the finest, int64 (B).
        parents: The coarser tile that stands for each, int64 (B); -1 in the coarsest level.
        counts: Gaussians of each, int64 (B).
        sizes: Bytes of each in the file, int64 (B).
        errors: How far what it shows is from the finest Gaussians, world units, float64 (B).
        low: Lower corner of the box around its centres, world units, float64 (B, 3).
        high: Upper corner.
    """

    levels: np.ndarray
    parents: np.ndarray
    counts: np.ndarray
    sizes: np.ndarray
    errors: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def num_tiles(self) -> int:
        """Tiles, B."""
        return len(self.levels)


def tiles_of(stream: SceneStream) -> Tiles:
    """The tiles of a stream with levels, of which packets may be missing.

    Raises:
        BitstreamError: If it has no index of tiles, or its side information is damaged.
    """
    info = open_side_info(stream.manifest, stream.side_info)
    index = read_tile_index(stream.manifest, info.sections)
    plan = stream.manifest.plan
    spans, boxes, unit = plan.spans, info.boxes, info.size_log - info.unit
    levels = np.repeat(np.arange(len(spans) - 1, -1, -1), [span.num_blocks for span in spans])
    parents = [np.full(spans[0].num_blocks, -1)]
    for coarser, span in itertools.pairwise(spans):
        parents.append(coarser.first_block + parents_of(span.num_blocks, coarser.num_blocks))
    high = boxes.corners + ((boxes.extents + 1) << boxes.shifts[:, None])
    return Tiles(
        levels.astype(np.int64), np.concatenate(parents).astype(np.int64),
        np.array([plan.block_anchors(block) for block in range(plan.num_blocks)], dtype=np.int64), index.sizes,
        index.errors.astype(np.float64), np.ldexp(boxes.corners.astype(np.float64), unit),
        np.ldexp(high.astype(np.float64), unit),
    )  # fmt: skip
