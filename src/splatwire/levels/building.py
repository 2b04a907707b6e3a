"""From a scene to its levels: tiles by a k-d tree, and for each a few Gaussians that stand for it from far away."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.levels.merging import reduced
from splatwire.levels.tiles import LevelShape, level_shapes
from splatwire.model import SplatScene
from splatwire.model.level_scene import LevelScene
from splatwire.ops.kd_order import kd_order
from splatwire.packets.tiles import parents_of
from splatwire.scene.splats import Splats


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
    order = kd_order(scene.splats.means.numpy(), _nested(shapes))
    levels, errors = [scene.splats.select(torch.from_numpy(order))], [np.zeros(shapes[0].num_tiles)]
    old_ones = [np.ones(shapes[0].count, dtype=bool)]
    total, done = sum(shape.count for shape in shapes[:-1]), 0
    for finer, shape in itertools.pairwise(shapes):
        parts, squares, olds = list[Splats](), np.zeros((shape.num_tiles, 2)), list[np.ndarray]()
        for parent, child, share in _shares(finer, shape):
            some, old, error = _reduced(levels[-1], finer, child, share)
            parts += [some] if share else []
            olds.append(np.arange(share) < old)
            below = errors[-1][child]
            squares[parent] += share * (error**2 + below**2), share
            done += int(np.diff(finer.edges[child : child + 2])[0])
            if progress:
                progress(done / total)
        levels.append(_joined(parts))
        old_ones.append(np.concatenate(olds))
        errors.append(np.sqrt(squares[:, 0] / squares[:, 1]))
    sizes = tuple(shape.count for shape in reversed(shapes))
    whole = LevelScene(_joined(levels[::-1]), background=scene.background, level_sizes=sizes)
    return Built(whole, order, np.concatenate(old_ones[::-1]), np.concatenate(errors[::-1]))


def _nested(shapes: tuple[LevelShape, ...]) -> list[np.ndarray]:
    """Bounds of the tiles of every level among the finest Gaussians, the coarsest first."""
    bounds, edges = [shapes[0].edges], np.arange(shapes[0].num_tiles + 1)
    for finer, shape in itertools.pairwise(shapes):
        firsts = np.searchsorted(parents_of(finer.num_tiles, shape.num_tiles), np.arange(shape.num_tiles + 1))
        edges = edges[firsts]
        bounds.append(shapes[0].edges[edges])
    return bounds[::-1]


def _shares(finer: LevelShape, shape: LevelShape) -> Iterator[tuple[int, int, int]]:
    """A tile, one of those that it stands for, and how many of its Gaussians are for that one."""
    parents = parents_of(finer.num_tiles, shape.num_tiles)
    for parent in range(shape.num_tiles):
        children = np.flatnonzero(parents == parent)
        first = finer.edges[children[0]]
        ends = (finer.edges[children + 1] - first) * shape.size // (finer.edges[children[-1] + 1] - first)
        for child, share in zip(children.tolist(), np.diff(ends, prepend=0).tolist(), strict=True):
            yield parent, child, share


def _reduced(level: Splats, shape: LevelShape, tile: int, count: int) -> tuple[Splats, int, float]:
    here = slice(int(shape.edges[tile]), int(shape.edges[tile + 1]))
    some = Splats(**{name: values[here] for name, values in vars(level).items()})
    return reduced(some, count) if count else (some, 0, 0.0)


def _joined(parts: list[Splats]) -> Splats:
    return Splats(**{name: torch.cat([getattr(part, name) for part in parts]) for name in vars(parts[0])})
