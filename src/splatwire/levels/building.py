"""From a scene to its levels: tiles by a k-d tree, and for each a few Gaussians that stand for it from far away."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.levels.merging import footprints, reduced
from splatwire.levels.tiles import LevelShape, level_shapes
from splatwire.model import SplatScene
from splatwire.model.level_scene import LevelScene
from splatwire.ops.kd_order import kd_order
from splatwire.packets.tiles import parents_of
from splatwire.scene.splats import ROWS, Splats

EVEN = 0.25
"""Share of a coarser tile's Gaussians that is shared out by how many each finer tile has, not by how large they are."""


@dataclass(frozen=True, eq=False)
class Built:
    """A scene with levels.

    Attributes:
        scene: All of them.
        order: Which Gaussian of the scene each of the finest level is, int64.
        old: Which Gaussians are those of the next finer level, not merged from several, bool (N).
        errors: How far centres of the finest Gaussians are from what stands for them in a tile, root of the mean
            square, world units; float64 (tiles of all levels, the coarsest first), 0 for the finest.
    """

    scene: LevelScene
    order: np.ndarray
    old: np.ndarray
    errors: np.ndarray


def build_levels(scene: SplatScene, tile: int, progress: Callable[[float], None] | None = None) -> Built:
    """Makes the levels of a scene.

    Args:
        scene: Gaussians, all of which can be drawn.
        tile: Most Gaussians of a tile.
        progress: Called with the share of the work that is done.
    """
    shapes = level_shapes(scene.num_elements, tile)
    order = kd_order(scene.splats.means, _nested(shapes))
    sizes = [shape.count for shape in shapes]
    whole, end = Splats.empty(sum(sizes), scene.splats.degree), sum(sizes)
    finest = whole.run(end - sizes[0], end)
    for begin in range(0, sizes[0], ROWS):
        finest.fill(begin, scene.splats.select(order[begin : begin + ROWS]))
    old, errors = np.ones(end, dtype=bool), [np.zeros(shapes[0].num_tiles)]
    total, done = sum(sizes[:-1]), 0
    for finer, shape in itertools.pairwise(shapes):
        below, end = whole.run(end - finer.count, end), end - finer.count
        level, squares, at = whole.run(end - shape.count, end), np.zeros((shape.num_tiles, 2)), end - shape.count
        for parent, child, share, mass in _shares(below, finer, shape):
            some, kept, error = _reduced(below, finer, child, share, mass)
            if share:
                level.fill(at - end + shape.count, some)
                old[at + kept : at + share] = False
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
    return Built(made, order, old, np.concatenate(errors[::-1]))


def _nested(shapes: tuple[LevelShape, ...]) -> list[np.ndarray]:
    """Bounds of the tiles of every level among the finest Gaussians, the coarsest first."""
    bounds, edges = [shapes[0].edges], np.arange(shapes[0].num_tiles + 1)
    for finer, shape in itertools.pairwise(shapes):
        firsts = np.searchsorted(parents_of(finer.num_tiles, shape.num_tiles), np.arange(shape.num_tiles + 1))
        edges = edges[firsts]
        bounds.append(shapes[0].edges[edges])
    return bounds[::-1]


def _shares(level: Splats, finer: LevelShape, shape: LevelShape) -> Iterator[tuple[int, int, int, np.ndarray]]:
    """A tile, one of those that it stands for, how many of its Gaussians are for that one, and its footprints."""
    parents = parents_of(finer.num_tiles, shape.num_tiles)
    for parent in range(shape.num_tiles):
        children = np.flatnonzero(parents == parent)
        runs = [level.run(*finer.edges[child : child + 2].tolist()) for child in children]
        found = [footprints(run) for run in runs]
        extents = np.array([np.sqrt(mass).sum() for mass in found])
        shares = shared_out(shape.size, extents, np.array([run.num_gaussians for run in runs]))
        yield from zip(itertools.repeat(parent), children.tolist(), shares.tolist(), found)


def shared_out(size: int, extents: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """How many coarser Gaussians each of some tiles gets: `EVEN` of them by their Gaussians, the others by their size.

    Args:
        size: Coarser Gaussians, at most as many as all tiles have.
        extents: How large the Gaussians of each tile are, float64 (C).
        counts: How many there are, int64 (C).

    Returns:
        As many as `size` together, and none more than it has, int64 (C).
    """
    weights = EVEN * counts / counts.sum() + (1 - EVEN) * extents / max(extents.sum(), 1e-300)
    shares = np.minimum(np.diff(np.rint(np.cumsum(weights) / weights.sum() * size).astype(np.int64), prepend=0), counts)
    for tile in np.argsort(-weights, kind="stable"):
        shares[tile] += min(size - shares.sum(), counts[tile] - shares[tile])
    return shares


def _reduced(level: Splats, shape: LevelShape, tile: int, count: int, mass: np.ndarray) -> tuple[Splats, int, float]:
    some = level.run(int(shape.edges[tile]), int(shape.edges[tile + 1]))
    return reduced(some, count, mass) if count else (some, 0, 0.0)
