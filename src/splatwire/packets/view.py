"""Which tiles a view shows, and which it needs next: the twin of `web/src/codec/levels/cut.ts`."""

from dataclasses import dataclass

import numpy as np

from splatwire.packets.tiles import Tiles

BUDGET = 1_000_000
"""Gaussians that a view shows at most."""
FINE_ENOUGH = 0.5
"""Pixels by which centres may be off: finer tiles are not worth their bytes."""
BEHIND = 0.05
"""What the error of a tile counts for that is not in the picture: somebody may turn."""
NEAREST = 0.02
"""Least distance of a tile, relative to its diagonal."""


@dataclass(frozen=True, eq=False)
class Look:
    """Where somebody looks from.

    Attributes:
        viewmat: World to camera, x right, y down, z ahead, float64 (4, 4).
        focal: Focal length, pixels.
        width: Of the picture, pixels.
        height: Of the picture, pixels.
    """

    viewmat: np.ndarray
    focal: float
    width: int
    height: int


@dataclass(frozen=True)
class Cut:
    """What a view has and wants.

    Attributes:
        drawn: Tiles to draw; they stand for the whole scene as far as it is there.
        wanted: Tiles that are not there, the most useful first.
    """

    drawn: tuple[int, ...]
    wanted: tuple[int, ...]


def pixel_errors(tiles: Tiles, look: Look | None) -> np.ndarray:
    """How far centres in each tile are off on the screen, pixels, float64 (B).

    Tiles that are not in the picture count for `BEHIND` of it; without a look, errors are those in world units.
    """
    if look is None:
        return tiles.errors.copy()
    middle, half = (tiles.low + tiles.high) / 2, (tiles.high - tiles.low) / 2
    radius = _length(half)
    eye = np.array([-sum(look.viewmat[row, axis] * look.viewmat[row, 3] for row in range(3)) for axis in range(3)])
    outside = np.maximum(np.abs(eye - middle) - half, 0)
    distance = np.maximum(_length(outside), np.maximum(2 * NEAREST * radius, 1e-9))
    x, y, z = (  # written out, so that every language adds in the same order
        row[0] * middle[:, 0] + row[1] * middle[:, 1] + row[2] * middle[:, 2] + row[3] for row in look.viewmat[:3]
    )
    across, down = look.width / 2 / look.focal, look.height / 2 / look.focal
    seen = z > -radius
    for side, slope in ((np.abs(x), across), (np.abs(y), down)):
        seen &= side - slope * z <= radius * np.sqrt(1 + slope * slope)
    return tiles.errors * look.focal / distance * np.where(seen, 1.0, BEHIND)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Of each row, (N, 3)."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def cut_of(tiles: Tiles, there: np.ndarray, look: Look | None, budget: int = BUDGET) -> Cut:
    """Refines where the screen's error is largest, until the budget is spent or the error is small everywhere.

    A tile gives way to the finer ones that it stands for when all of them are there.

    Args:
        tiles: The tiles.
        there: Which of them arrived, bool (B).
        look: Where somebody looks from; None for nowhere, which goes from coarse to fine all over.
        budget: Gaussians that are drawn at most.
    """
    levels, finer = tiles.levels, np.flatnonzero(tiles.parents >= 0)
    below, roots = tiles.parents[finer], np.flatnonzero(tiles.parents < 0)
    refined = _refined(tiles, look, budget, finer, below)
    giving_way = np.zeros(tiles.num_tiles, dtype=bool)
    giving_way[refined] = True
    giving_way[below[~there[finer]]] = False
    real = there.copy()
    for level in range(int(levels.max(initial=0)) - 1, -1, -1):
        here = levels == level
        parents = tiles.parents[here]
        real[here] = real[parents] & giving_way[parents]
    place = np.full(tiles.num_tiles, -1)
    place[refined] = np.arange(len(refined))
    absent = finer[(place[below] >= 0) & ~there[finer]]
    wanted = absent[np.argsort(place[tiles.parents[absent]], kind="stable")]
    drawn = np.flatnonzero(real & ~giving_way)
    return Cut(tuple(drawn.tolist()), (*roots[~there[roots]].tolist(), *wanted.tolist()))


def _refined(tiles: Tiles, look: Look | None, budget: int, finer: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Tiles whose finer ones are shown or wanted, the most useful first: no tile before what stands for it."""
    urgent = pixel_errors(tiles, look)
    for level in range(int(tiles.levels.max(initial=0)) - 1, -1, -1):
        here = np.flatnonzero((tiles.levels == level) & (tiles.parents >= 0))
        urgent[here] = np.minimum(urgent[here], urgent[tiles.parents[here]])
    more = np.bincount(below, tiles.counts[finer], tiles.num_tiles).astype(np.int64) - tiles.counts
    parents = np.unique(below)
    some = parents[urgent[parents] > (FINE_ENOUGH if look is not None else 0.0)]
    order = some[np.argsort(-urgent[some], kind="stable")]
    spent = tiles.counts[tiles.parents < 0].sum() + np.cumsum(more[order])
    over = np.flatnonzero(spent > budget)
    return order[: over[0]] if len(over) else order
