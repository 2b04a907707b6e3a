"""Outliers: a few Gaussians with extreme values, which make the quantisation of all others coarse.

SPZ and SOG divide the range of all positions into quantisation steps. Compressed PLY does so for every 256 Gaussians.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from splatwire.errors import UnknownNameError
from splatwire.ops.knn import NeighborTree
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
Outliers = Literal["clamp", "prune", "keep"]
"""Treatment of outliers: `clamp` moves them to the end of the range of the other values, `prune` removes them,
`keep` writes them unchanged at the cost of the precision of the others."""
DEFAULT: Outliers = "clamp"
SHARES = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
"""Maximum share of the values that counts as outliers (at least one value), tried in ascending order until the other
values are not rounded visibly."""
VISIBLE_DIVISOR = 8.0
"""Position errors are visible if larger than the local scale (`local_scales`) divided by this number."""
FINE_DIVISOR = 16.0
"""Outliers are removed or moved, and chunks are split, if position errors exceed the local scale divided by this
number."""
_MAX_COSTLY_SHARE = 0.01
"""Outliers are left unchanged if at most this share of the Gaussians has position errors above the limit of
`FINE_DIVISOR`."""
_NEIGHBOURS = 4
_MIN_DISTANCE_RATIO = 4.0
"""Minimum distance of outliers from the median, divided by the distance of the farthest Gaussian that is not an
outlier.
"""
_CLIP_TOLERANCE = 1 / 16
"""Distance of colours and harmonics from the range of a format up to which clipping is invisible."""
_SCALE_TOLERANCE = 0.25
"""Raising the scales of a Gaussian to the minimum of a format is invisible if this minimum is at most this share of the
Gaussian's largest scale."""
_MIN_VISIBLE_SHARE = 0.01
"""Smallest share of too small Gaussians that is visible; a few of them in a scene of larger ones are below a pixel."""
_MIN_GAUSSIANS = 8
"""Minimum number of Gaussians for a scene to have outliers."""
_TREATMENT_TEXTS = {
    "clamp": "moved to the end of the range of the others",
    "prune": "left out",
    "keep": "kept (--outliers keep)",
}


@dataclass(frozen=True, eq=False)
class Column:
    """Values of one attribute of all Gaussians, and which of them are outliers.

    Attributes:
        values: float64 (N, C).
        middle: Median of each component, float64 (C).
        reach: Limit on the distance from `middle` (maximum norm); a value beyond it is an outlier.
        outside: Mask of the outliers, bool (N).
    """

    values: np.ndarray
    middle: np.ndarray
    reach: float
    outside: np.ndarray

    @property
    def distances(self) -> np.ndarray:
        """Distance of each value from the median in the maximum norm, float64 (N)."""
        return np.asarray(np.abs(self.values - self.middle).max(axis=1))

    @property
    def others(self) -> np.ndarray:
        """Values of the column that are not outliers, float64 (n, C)."""
        return self.values[~self.outside]


def check_outliers(name: str) -> Outliers:
    """Checks that `name` is a treatment of outliers: `clamp`, `prune` or `keep`.

    Raises:
        UnknownNameError: If it is another name.
    """
    for choice in get_args(Outliers):
        if name == choice:
            return choice
    raise UnknownNameError("treatment of outliers", name, get_args(Outliers))


def find_outliers(values: np.ndarray, share: float = SHARES[0]) -> Column:
    """Finds the values of an attribute that are far from the median of all values.

    Args:
        values: Finite values, float64 (N, C).
        share: Maximum share of outliers, up to 0.5.

    Returns:
        The values, and a mask of the outliers.
    """
    values = np.asarray(values, np.float64)
    middle = np.median(values, axis=0)
    distances = np.abs(values - middle).max(axis=1)
    if len(values) < _MIN_GAUSSIANS:
        return Column(values, middle, float(distances.max(initial=0.0)), np.zeros(len(values), bool))
    allowed = max(1, int(share * len(values)))
    usual_distance = float(np.partition(distances, -allowed - 1)[-allowed - 1])
    reach = max(_MIN_DISTANCE_RATIO * usual_distance, float(np.finfo(np.float32).tiny))
    return Column(values, middle, reach, distances > reach)


def costly_outliers(splats: Splats, errors: Callable[[Column], np.ndarray]) -> Column:
    """Finds distant Gaussians (outliers) whose removal makes the quantisation errors of the others invisible.

    Distant Gaussians enlarge the quantisation steps of all positions. Larger and larger shares of Gaussians are
    regarded as outliers until the errors of the remaining Gaussians are invisible. If no share is large enough, the
    smallest share is used.

    Args:
        splats: The Gaussians.
        errors: Function that predicts the quantisation errors of positions after the outliers are removed. Its
            argument has all positions and a mask of the outliers. For each remaining Gaussian, it returns the largest
            error along an axis, world units, float64 (n).

    Returns:
        Positions of all Gaussians, and a mask of the outliers.
    """
    scales_of_all: list[np.ndarray] = []

    def is_costly(column: Column) -> bool:
        inside, step_errors = ~column.outside, errors(column)
        if not _are_visible(step_errors, np.median(splats.scales[inside], axis=1)):
            return False
        scales_of_all[:] = scales_of_all or [local_scales(splats, np.arange(splats.num_gaussians))]
        return _are_visible(step_errors, scales_of_all[0][inside])

    # Tries the shares in ascending order; if none suffices, the smallest one is used.
    first = find_outliers(splats.means)
    if not is_costly(first):
        return first
    columns = (find_outliers(splats.means, share) for share in SHARES[1:])
    return next((column for column in columns if column.outside.any() and not is_costly(column)), first)


def local_scales(splats: Splats, rows: np.ndarray) -> np.ndarray:
    """Returns a local length scale for each given Gaussian.

    A position error is visible if it exceeds a fixed fraction of this length.

    Args:
        splats: All Gaussians.
        rows: Indices of the Gaussians, int64 (n).

    Returns:
        Distance to the fourth nearest neighbour, or the middle of the three standard deviations if that is larger,
        world units, float64 (n).
    """
    if not len(rows):
        return np.zeros(0)
    means = splats.means.astype(np.float64)
    _, distances = NeighborTree(means).query(means[rows], _NEIGHBOURS + 1)
    return np.maximum(distances[:, -1], np.median(splats.scales[rows].astype(np.float64), axis=1))


def visible_errors(errors: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Returns the mask of Gaussians with a visible position error, bool (N).

    Args:
        errors: Largest position error of each Gaussian along any axis, world units, (N).
        scales: Local length scale of each Gaussian, from `local_scales`, (N).
    """
    return np.asarray(errors > scales / VISIBLE_DIVISOR)


def _are_visible(errors: np.ndarray, scales: np.ndarray) -> bool:
    """True if more than 1 % of the Gaussians have a position error that is too large for their local length scale.

    Args:
        errors: Largest position error of each Gaussian along any axis, world units, (n).
        scales: Local length scale of each Gaussian, from `local_scales`, (n).
    """
    return bool(len(errors)) and float((errors > scales / FINE_DIVISOR).mean()) > _MAX_COSTLY_SHARE


def warn_of_errors(path: Path, errors: np.ndarray, scales: np.ndarray) -> None:
    """Logs a warning with the number and size of visible position errors in a file.

    Args:
        path: The file, for the message.
        errors: Largest position error of each Gaussian along any axis, world units, (N).
        scales: Local length scale of each Gaussian, from `local_scales`, (N).
    """
    seen = visible_errors(errors, scales)
    if not seen.any():
        return
    LOG.warning(
        "%s: positions of %s of %s Gaussians are rounded by up to %.3g, and their neighbours are %.3g away (median): "
        "near and far Gaussians share the steps of this format; PLY keeps them, `--outliers prune` drops far ones",
        path, f"{int(seen.sum()):,}", f"{len(seen):,}", float(errors[seen].max()), float(np.median(scales[seen])),
    )  # fmt: skip


def warn_of_clipped(
    path: Path, attribute: str, values: np.ndarray, low: float, high: float, rows_are: str = "Gaussians"
) -> None:
    """Logs a warning if values of Gaussians are visibly clipped to the range of a format.

    Args:
        path: The file, for the message.
        attribute: Name of the values, such as `base colours`.
        values: Values before clipping, (N, ...).
        low: Smallest value that the format can represent.
        high: Largest value that the format can represent.
        rows_are: Name of the rows of `values`, for the message.
    """
    rows = np.asarray(values, np.float64).reshape(len(values), -1)
    if not rows.size:
        return
    outside = (rows.min(axis=1) < low - _CLIP_TOLERANCE) | (rows.max(axis=1) > high + _CLIP_TOLERANCE)
    if outside.any():
        LOG.warning(
            "%s: %s of %s of %s %s, from %.3g to %.3g, are clipped to the range of this format, %.3g to %.3g: "
            "the scene may look different; PLY keeps them",
            path, attribute, f"{int(outside.sum()):,}", f"{len(rows):,}", rows_are, rows[outside].min(),
            rows[outside].max(), low, high,
        )  # fmt: skip


def warn_of_scales(path: Path, scales: np.ndarray, low: float, high: float) -> None:
    """Logs a warning if scales of Gaussians are visibly clipped to the range of a format.

    Args:
        path: The file, for the message.
        scales: Standard deviations, (N, 3).
        low: Natural logarithm of the smallest scale that the format can represent.
        high: Natural logarithm of the largest scale that the format can represent.
    """
    least, most = np.exp((low, high))
    largest = scales.max(axis=1)
    # a few Gaussians that are too small are hardly visible
    smaller = largest * _SCALE_TOLERANCE < least
    outside = (smaller & (smaller.mean() > _MIN_VISIBLE_SHARE)) | (largest > most * (1 + _SCALE_TOLERANCE))
    if outside.any():
        LOG.warning(
            "%s: scales of %s of %s Gaussians are outside of %.2g to %.3g, the range of this format, and are clipped "
            "to it: Gaussians look larger or smaller, so give the scene another size first",
            path, f"{int(outside.sum()):,}", f"{len(outside):,}", least, most,
        )  # fmt: skip


def spatial_order(positions: Column) -> np.ndarray:
    """Sorts Gaussians along a space-filling (Morton) curve.

    Outliers come last, sorted by their distance from the median.

    Args:
        positions: Centres of the Gaussians, with outliers marked.

    Returns:
        Indices of the Gaussians in sorted order, int64 (N).
    """
    inside = np.flatnonzero(~positions.outside)
    outside = np.flatnonzero(positions.outside)
    far = outside[np.argsort(positions.distances[outside], kind="stable")]
    return np.concatenate([inside[morton_order(positions.values[inside])], far])


def morton_order(means: np.ndarray) -> np.ndarray:
    """Returns the order of points along a space-filling (Morton) curve with 42 bits per axis.

    Args:
        means: Coordinates of at least one point, finite, float64 (N, 3).

    Returns:
        Indices of the points in sorted order, int64 (N).
    """
    # with this number of bits, even a small object in a scene a million times as large is sorted
    low = means.min(axis=0)
    extent = max(float((means - low).max()), 1e-30)
    cells = ((means - low) / extent * ((1 << 2 * MAX_AXIS_BITS) - 1)).astype(np.int64)
    fine, coarse = morton_encode(cells & ((1 << MAX_AXIS_BITS) - 1)), morton_encode(cells >> MAX_AXIS_BITS)
    return np.lexsort((fine, coarse))


def pull_into_box(splats: Splats, index: np.ndarray, middle: np.ndarray, low: np.ndarray, high: np.ndarray) -> Splats:
    """Moves distant Gaussians into a box and shrinks them so that their appearance from inside the box is unchanged.

    Args:
        splats: All Gaussians.
        index: Indices of the Gaussians to move, int64 (n).
        middle: Point in the box towards which the Gaussians are moved, (3).
        low: Minimum coordinates of the box, (3).
        high: Maximum coordinates of the box, (3).
    """
    origins, scales = splats.means[index].astype(np.float64), splats.scales.copy()
    directions = origins - middle
    with np.errstate(divide="ignore", invalid="ignore"):
        limits = np.where(
            directions > 0, (high - middle) / directions, np.where(directions < 0, (low - middle) / directions, np.inf)
        )
    factors = np.minimum(limits.min(axis=1), 1)[:, None]
    means = splats.means.copy()
    means[index] = middle + directions * factors
    scales[index] = np.maximum(scales[index] * factors, np.finfo(np.float32).tiny)
    return replace(splats, means=means, scales=scales)


def treated_positions(
    splats: Splats, treatment: Outliers, index: np.ndarray, middle: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Splats:
    """Applies a treatment to positions that are outliers: keep, remove, or move into a box.

    Args:
        splats: The Gaussians.
        treatment: `clamp` to move the outliers into the box, `prune` to remove them, or `keep`.
        index: Indices of the outliers, int64 (n).
        middle: Point in the box towards which outliers are moved, (3).
        low: Minimum coordinates of the box, (3).
        high: Maximum coordinates of the box, (3).
    """
    if treatment == "keep":
        return splats
    if treatment == "clamp":
        return pull_into_box(splats, index, middle, low, high)
    kept = np.ones(splats.num_gaussians, np.bool_)
    kept[index] = False
    return splats.select(kept)


def warn_of_outliers(
    path: Path,
    treatment: Outliers,
    attribute: str,
    column: Column,
    steps: tuple[float, float],
    count: int | None = None,
) -> None:
    """Logs a warning about extreme values (outliers) in a scene: their number, effect and treatment.

    Args:
        path: The file.
        treatment: Treatment of the outliers: `clamp`, `prune` or `keep`.
        attribute: Name of the attribute that has outliers, such as `positions`.
        column: Values of the attribute, and a mask of the outliers.
        steps: Two quantisation steps of the other values: with the outliers unchanged, and with the outliers treated.
        count: Number of outliers that are moved or removed; None for all outliers of `column`.
    """
    number, total = int(column.outside.sum()) if count is None else count, len(column.values)
    far, usual = float(column.distances.max()), float(column.distances[~column.outside].max())
    LOG.warning(
        "%s: %s of %s Gaussians have outlying %s, up to %.4g from the median (the others up to %.4g); with them steps "
        "of the others are %.3g, without them %.3g; outliers are %s",
        path, f"{number:,}", f"{total:,}", attribute, far, usual, *steps, _TREATMENT_TEXTS[treatment],
    )  # fmt: skip
