"""Construction of levels of detail."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream.tiles import parents_of
from splatwire.lod.merging import footprints, reduce_gaussians
from splatwire.lod.tiles import LevelShape, level_shapes
from splatwire.ops.kd_order import kd_order
from splatwire.types import SplatScene
from splatwire.types.lod_scene import LevelScene
from splatwire.types.splats import CHUNK_GAUSSIANS, Splats

EVEN = 0.25
"""Fraction of a tile's Gaussians that its finer tiles get in proportion to their number of Gaussians; the rest is in
proportion to the size of their Gaussians."""


@dataclass(frozen=True, eq=False)
class BuiltLevels:
    """Levels of detail of a scene, and their relation to the original Gaussians.

    A tile is a spatial block of neighbouring Gaussians of one level.

    Attributes:
        scene: Gaussians of all levels of detail, coarsest level first.
        order: For each Gaussian of the finest level, its index in the original scene, int64.
        is_copy: Mask of Gaussians that are unchanged copies; all others are results of merging, bool (N).
        errors: Error of each tile, coarsest level first, float64: root mean square distance between the original
            Gaussians and their replacements, world units.
    """

    scene: LevelScene
    order: np.ndarray
    is_copy: np.ndarray
    errors: np.ndarray


def build_levels(scene: SplatScene, tile: int, progress: Callable[[float], None] | None = None) -> BuiltLevels:
    """Builds the levels of detail of a scene.

    Args:
        scene: Valid Gaussians.
        tile: Maximum number of Gaussians per tile.
        progress: Called with the completed fraction.
    """
    shapes = level_shapes(scene.num_elements, tile)
    order = kd_order(scene.splats.means, _tile_boundaries(shapes))
    sizes = [shape.count for shape in shapes]
    whole, end = Splats.empty(sum(sizes), scene.splats.degree), sum(sizes)
    finest = whole.slice_range(end - sizes[0], end)
    for begin in range(0, sizes[0], CHUNK_GAUSSIANS):
        finest.fill(begin, scene.splats.select(order[begin : begin + CHUNK_GAUSSIANS]))
    is_copy, errors = np.ones(end, dtype=bool), [np.zeros(shapes[0].num_tiles)]
    total, done = sum(sizes[:-1]), 0
    for finer, shape in itertools.pairwise(shapes):
        below, end = whole.slice_range(end - finer.count, end), end - finer.count
        level, squares, at = (
            whole.slice_range(end - shape.count, end),
            np.zeros((shape.num_tiles, 2)),
            end - shape.count,
        )
        for parent, child, share, mass in _gaussians_per_tile(below, finer, shape):
            reduced, kept, error = _reduced(below, finer, child, share, mass)
            if share:
                level.fill(at - end + shape.count, reduced)
                is_copy[at + kept : at + share] = False
                at += share
            squares[parent] += share * (error**2 + errors[-1][child] ** 2), share
            done += int(np.diff(finer.edges[child : child + 2])[0])
            if progress:
                progress(done / total)
        errors.append(np.sqrt(squares[:, 0] / squares[:, 1]))
    levels = tuple(sizes[::-1])
    made = LevelScene(
        whole,
        background=scene.background,
        antialiased=scene.antialiased,
        origin=scene.origin,
        metadata=scene.metadata,
        level_sizes=levels,
    )
    return BuiltLevels(made, order, is_copy, np.concatenate(errors[::-1]))


def _tile_boundaries(shapes: tuple[LevelShape, ...]) -> list[np.ndarray]:
    """Returns the boundaries of the tiles of each level of detail, coarsest level first.

    A tile of any level represents a range of the sorted Gaussians of the finest level. Its boundary is the index of the
    first Gaussian in this range. The last boundary of each level is the number of Gaussians of the finest level.
    """
    bounds, edges = [shapes[0].edges], np.arange(shapes[0].num_tiles + 1)
    for finer, shape in itertools.pairwise(shapes):
        firsts = np.searchsorted(parents_of(finer.num_tiles, shape.num_tiles), np.arange(shape.num_tiles + 1))
        edges = edges[firsts]
        bounds.append(shapes[0].edges[edges])
    return bounds[::-1]


def _gaussians_per_tile(
    splats: Splats, finer: LevelShape, shape: LevelShape
) -> Iterator[tuple[int, int, int, np.ndarray]]:
    """Decides how many Gaussians of the next coarser level of detail represent each tile of the finer level.

    Args:
        splats: Gaussians of the finer level.
        finer: Sizes of the finer level and its tiles.
        shape: Sizes of the next coarser level and its tiles.

    Yields:
        Four values for each tile of the finer level:

        * Index of the coarser tile that replaces this tile.
        * Index of this tile.
        * Number of Gaussians of the coarser tile that represent this tile.
        * Result of `footprints` for the Gaussians of this tile.
    """
    parents = parents_of(finer.num_tiles, shape.num_tiles)
    for parent in range(shape.num_tiles):
        children = np.flatnonzero(parents == parent)
        tiles = [splats.slice_range(*finer.edges[child : child + 2].tolist()) for child in children]
        footprints_by_tile = [footprints(tile) for tile in tiles]
        extents = np.array([np.sqrt(mass).sum() for mass in footprints_by_tile])
        shares = distribute(shape.size, extents, np.array([tile.num_gaussians for tile in tiles]))
        yield from zip(itertools.repeat(parent), children.tolist(), shares.tolist(), footprints_by_tile)


def distribute(size: int, extents: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Divides the Gaussians of a coarser tile among the finer tiles that it replaces.

    A finer tile with more or larger Gaussians gets a larger share.

    Args:
        size: Number of Gaussians of the coarser tile.
        extents: Sum of the sizes (square roots of `footprints`) of each finer tile's Gaussians, float64 (C).
        counts: Number of Gaussians of each finer tile, int64 (C).

    Returns:
        Number of Gaussians that represent each finer tile, int64 (C); the sum is `size`, no number exceeds `counts`.
    """
    # `EVEN` is the weight of the number of Gaussians; the rest is the weight of their size.
    weights = EVEN * counts / counts.sum() + (1 - EVEN) * extents / max(extents.sum(), 1e-300)
    shares = np.minimum(np.diff(np.rint(np.cumsum(weights) / weights.sum() * size).astype(np.int64), prepend=0), counts)
    for tile in np.argsort(-weights, kind="stable"):
        shares[tile] += min(size - shares.sum(), counts[tile] - shares[tile])
    return shares


def _reduced(splats: Splats, shape: LevelShape, tile: int, count: int, mass: np.ndarray) -> tuple[Splats, int, float]:
    tile_splats = splats.slice_range(int(shape.edges[tile]), int(shape.edges[tile + 1]))
    return reduce_gaussians(tile_splats, count, mass) if count else (tile_splats, 0, 0.0)
