"""Which tiles a view shows, and which it needs next: the twin of `web/src/codec/levels/cut.ts`."""

from dataclasses import dataclass

import numpy as np

from splatwire.packets.tiles import Tiles
from splatwire.reprs import summary_repr

BUDGET = 1_000_000
"""Gaussians that a view shows at most."""
FINE_ENOUGH = 0.48
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

    __repr__ = summary_repr


@dataclass(frozen=True)
class Cut:
    """What a view has and wants.

    Attributes:
        drawn: Tiles to draw, with each the coarser ones above it; of those what stands for tiles that are drawn is left
            out (`stands_for`).
        wanted: Tiles that are not there, the most useful first.
    """

    drawn: tuple[int, ...]
    wanted: tuple[int, ...]


def pixel_errors(tiles: Tiles, look: Look | None) -> np.ndarray:
    """How far centres are off on the screen where a tile is not drawn, pixels, float64 (B).

    Tiles that are not in the picture count for `BEHIND` of it; without a look, errors are those in world units. Of the
    coarsest level infinite: nothing stands for it.
    """
    return _worth(tiles, look)[0]


def _worth(tiles: Tiles, look: Look | None) -> tuple[np.ndarray, np.ndarray]:
    """`pixel_errors`, and what each tile brings for a byte: what it covers of the picture, infinite of the coarsest."""
    errors = np.where(tiles.parents < 0, np.inf, tiles.errors[tiles.parents])
    if look is None:
        return errors, errors.copy()
    distance, seen, covered = _seen(tiles, look)
    counts = np.where(seen, 1.0, BEHIND)
    useful = np.where(tiles.parents < 0, np.inf, covered * counts / np.maximum(tiles.sizes, 1))
    return errors * look.focal / distance * counts, useful


def _seen(tiles: Tiles, look: Look) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of each box; whether it is in the picture; and what of the picture it covers, square pixels.

    In the picture that is a rectangle, for which a box is as deep as it is far away or deeper; elsewhere the mean over
    all directions from which the box could be seen.
    """
    middle, half = (tiles.low + tiles.high) / 2, (tiles.high - tiles.low) / 2
    eye = np.array([-sum(look.viewmat[row, axis] * look.viewmat[row, 3] for row in range(3)) for axis in range(3)])
    outside = np.maximum(np.abs(eye - middle) - half, 0)
    distance = np.maximum(_length(outside), np.maximum(2 * NEAREST * _length(half), 1e-9))
    # Written out, so that every language adds in the same order.
    place = [row[0] * middle[:, 0] + row[1] * middle[:, 1] + row[2] * middle[:, 2] + row[3] for row in look.viewmat[:3]]
    reach = [abs(row[0]) * half[:, 0] + abs(row[1]) * half[:, 1] + abs(row[2]) * half[:, 2] for row in look.viewmat[:3]]
    near = np.maximum(place[2] - reach[2], distance)
    far = np.maximum(place[2] + reach[2], near)
    seen, rectangle = place[2] + reach[2] > 0, np.ones(tiles.num_tiles)
    for axis, edge in enumerate((look.width / 2 / look.focal, look.height / 2 / look.focal)):
        low, high = place[axis] - reach[axis], place[axis] + reach[axis]
        low, high = low / np.where(low < 0, near, far), high / np.where(high < 0, far, near)
        extent = np.minimum(high, edge) - np.maximum(low, -edge)
        seen &= extent > 0
        rectangle = rectangle * extent * look.focal
    a, b, c = half.T
    scale = look.focal / distance
    anywhere = np.minimum(2 * (a * b + b * c + c * a) * scale * scale, float(look.width * look.height))
    return distance, seen, np.where(seen, rectangle, anywhere)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Of each row, (N, 3)."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def cut_of(tiles: Tiles, there: np.ndarray, look: Look | None, budget: int = BUDGET) -> Cut:
    """Takes what is most useful for a byte, until the budget is spent or the error is small everywhere.

    Args:
        tiles: The tiles.
        there: Which of them arrived, bool (B).
        look: Where somebody looks from; None for nowhere, which goes from coarse to fine all over.
        budget: Gaussians of tiles that are drawn at most; the coarsest level is drawn in any case.
    """
    chosen = _chosen(tiles, look, budget)
    real = np.zeros(tiles.num_tiles, dtype=bool)
    real[chosen] = there[chosen]
    for level in range(int(tiles.levels.max(initial=0)) - 1, -1, -1):
        here = np.flatnonzero((tiles.levels == level) & (tiles.parents >= 0))
        real[here] &= real[tiles.parents[here]]
    return Cut(tuple(np.flatnonzero(real).tolist()), tuple(chosen[~there[chosen]].tolist()))


def _chosen(tiles: Tiles, look: Look | None, budget: int) -> np.ndarray:
    """Tiles that are shown or wanted, the most useful first: no tile before what stands for it."""
    errors, useful = _worth(tiles, look)
    for level in range(int(tiles.levels.max(initial=0)) - 1, -1, -1):
        here = np.flatnonzero((tiles.levels == level) & (tiles.parents >= 0))
        for values in (errors, useful):
            values[here] = np.minimum(values[here], values[tiles.parents[here]])
    some = np.flatnonzero(errors > (FINE_ENOUGH if look is not None else 0.0))
    order = some[np.argsort(-useful[some], kind="stable")]
    over = np.flatnonzero((np.cumsum(tiles.counts[order]) > budget) & (tiles.parents[order] >= 0))
    return order[: over[0]] if len(over) else order


def stands_for(tiles: Tiles, tile: int, means: np.ndarray) -> np.ndarray:
    """Which of the finer tiles below a tile each of its Gaussians stands for: the one whose box is nearest.

    Args:
        tiles: The tiles.
        tile: One of them.
        means: Centres of some of its Gaussians, float64 (N, 3).

    Returns:
        Tiles, int64 (N); -1 for Gaussians of the finest level.
    """
    finer = np.flatnonzero(tiles.parents == tile)
    if not len(finer):
        return np.full(len(means), -1, dtype=np.int64)
    outside = np.maximum(np.maximum(tiles.low[finer][:, None] - means, means - tiles.high[finer][:, None]), 0)
    return finer[outside.max(axis=2).argmin(axis=0)]
