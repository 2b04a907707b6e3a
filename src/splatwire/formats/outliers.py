"""Outliers: few Gaussians with numbers that cost all others precision in formats with steps of a shared range.

A trainer may leave one Gaussian a million units away. Formats that divide the range of all positions (SPZ, SOG) or of
256 Gaussians (compressed PLY) into steps would then round all others to large steps.
"""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from splatwire.errors import UnknownNameError
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
Outliers = Literal["clamp", "prune", "keep"]
"""Treatment: `clamp` moves outliers to the end of the range of the others, `prune` leaves them out, `keep` writes them
unchanged at the cost of the others."""
DEFAULT: Outliers = "clamp"
_MAX_SHARE = 0.01
"""Maximum share of Gaussians that are outliers of a column, at least one Gaussian."""
_REACH = 4.0
"""Outliers are farther from the median than this times the farthest of the others."""
_FEWEST = 8
"""Minimum number of Gaussians of a scene with outliers."""
_DONE = {"clamp": "moved to the end of the range of the others", "prune": "left out", "keep": "kept (--outliers keep)"}


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a scene and its outliers.

    Attributes:
        values: float64 (N, C).
        middle: Median of each component, (C).
        reach: Distance from the middle beyond which a value is an outlier, maximum norm.
        outside: Mask of the outliers, bool (N).
    """

    values: np.ndarray
    middle: np.ndarray
    reach: float
    outside: np.ndarray

    @property
    def distances(self) -> np.ndarray:
        """Distance of each row from the middle, maximum norm."""
        return np.asarray(np.abs(self.values - self.middle).max(axis=1))

    @property
    def others(self) -> np.ndarray:
        """Rows that are no outliers."""
        return self.values[~self.outside]


def check_outliers(name: str) -> Outliers:
    """Returns the treatment of that name.

    Raises:
        UnknownNameError: If there is none.
    """
    for known in get_args(Outliers):
        if name == known:
            return known
    raise UnknownNameError("treatment of outliers", name, get_args(Outliers))


def find_outliers(values: np.ndarray) -> Column:
    """Finds the outliers of a column.

    Args:
        values: Finite, (N, C).

    Returns:
        The column. At most one hundredth of the rows are outliers.
    """
    wide = np.asarray(values, np.float64)
    middle = np.median(wide, axis=0)
    distances = np.abs(wide - middle).max(axis=1)
    if len(wide) < _FEWEST:
        return Column(wide, middle, float(distances.max(initial=0.0)), np.zeros(len(wide), bool))
    allowed = max(1, int(_MAX_SHARE * len(wide)))
    usual = float(np.partition(distances, -allowed - 1)[-allowed - 1])
    reach = max(_REACH * usual, float(np.finfo(np.float32).tiny))
    return Column(wide, middle, reach, distances > reach)


def spatial_order(positions: Column) -> np.ndarray:
    """Order of Gaussians along a Morton curve through those that are no outliers; outliers follow, nearest first.

    Args:
        positions: Column of the centres.

    Returns:
        Index of the Gaussian at each place, int64 (N).
    """
    inside = np.flatnonzero(~positions.outside)
    means = positions.values[inside]
    low = means.min(axis=0)
    extent = max(float((means - low).max()), 1e-30)
    codes = morton_encode(((means - low) / extent * ((1 << MAX_AXIS_BITS) - 1)).astype(np.int64))
    outside = np.flatnonzero(positions.outside)
    far = outside[np.argsort(positions.distances[outside], kind="stable")]
    return np.concatenate([inside[np.argsort(codes, kind="stable")], far])


def pull_into_box(splats: Splats, index: np.ndarray, middle: np.ndarray, low: np.ndarray, high: np.ndarray) -> Splats:
    """Moves some Gaussians towards the middle until their centres are within a box, and scales them by the same factor.

    The view from the middle does not change.

    Args:
        splats: All Gaussians.
        index: Index of those that are moved, int64 (n).
        middle: The point that they are moved to, within the box, (3).
        low: Least coordinates of the box, (3).
        high: Largest coordinates of the box, (3).
    """
    places, scales = splats.means[index].astype(np.float64), splats.scales.copy()
    ways = places - middle
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(ways > 0, (high - middle) / ways, np.where(ways < 0, (low - middle) / ways, np.inf))
    factors = np.minimum(room.min(axis=1), 1)[:, None]
    means = splats.means.copy()
    means[index] = middle + ways * factors
    scales[index] = np.maximum(scales[index] * factors, np.finfo(np.float32).tiny)
    return replace(splats, means=means, scales=scales)


def treated_positions(
    splats: Splats, treatment: Outliers, index: np.ndarray, middle: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Splats:
    """Returns the Gaussians with the outliers at `index` treated; arguments as of `pull_into_box`."""
    if treatment == "keep":
        return splats
    if treatment == "clamp":
        return pull_into_box(splats, index, middle, low, high)
    kept = np.ones(splats.num_gaussians, np.bool_)
    kept[index] = False
    return splats.select(kept)


def warn_of_outliers(
    path: Path, treatment: Outliers, what: str, column: Column, steps: tuple[float, float], count: int | None = None
) -> None:
    """Logs the number of outliers, their distance, their cost to the others, and their treatment.

    Args:
        path: The file.
        treatment: Their treatment.
        what: Name of the values, such as `positions`.
        column: The values.
        steps: Steps of the others with the outliers, and without.
        count: Number of outliers that are treated; None for all.
    """
    number, total = int(column.outside.sum()) if count is None else count, len(column.values)
    far, usual = float(column.distances.max()), float(column.distances[~column.outside].max())
    LOG.warning(
        "%s: %s of %s Gaussians have outlying %s, up to %.4g from the median (the others up to %.4g); with them steps "
        "of the others are %.3g, without them %.3g; outliers are %s",
        path, f"{number:,}", f"{total:,}", what, far, usual, *steps, _DONE[treatment],
    )  # fmt: skip
