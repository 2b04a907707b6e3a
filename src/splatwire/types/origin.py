"""Origins of geo-referenced scenes: positions are float32 relative to a point with float64 coordinates.

At map coordinates (UTM, ECEF), float32 alone has a precision of half a metre.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from splatwire.errors import InvalidValueError, shown

Origin = tuple[float, float, float]
"""World coordinates of the point that positions are relative to, float64."""
NO_ORIGIN: Origin = (0.0, 0.0, 0.0)
"""Origin of scenes with positions in world coordinates."""
_MAX_COORDINATE = 1e12
"""Largest absolute value of an origin's coordinates."""
_SAMPLE = 1 << 16
"""Maximum number of positions in the sample for the choice of an origin."""
_SPREAD_QUANTILES = (0.05, 0.95)
"""Quantiles of the positions; the distance between the two is the spread, which a few far outliers do not change."""
_LOW_RATIO, _LOW_MIN_DISTANCE = 8.0, 16.0
"""Low thresholds, for float64 positions: minimum ratio of the distance from 0 to the spread, and minimum distance
from 0. An origin is used if both are exceeded."""
_HIGH_RATIO, _HIGH_MIN_DISTANCE = 256.0, 1000.0
"""High thresholds, for float32 positions: ratio of distance to spread, and distance from 0. Precision is already lost
there, so only file formats with fewer bits benefit from an origin."""
_PRECISE_RATIO = 256.0
"""Ratio of the distance from 0 to the spread above which float32 would round precise positions visibly."""
_MAX_STEP_SPREADS = 64.0
"""Origins are rounded to multiples of a step: 1, or a smaller power of 2 of at most this many spreads."""


def check_origin(values: object) -> Origin:
    """Validates an origin read from a file and returns it as three floats.

    Raises:
        InvalidValueError: If `values` is not three finite numbers of at most 1e12.
    """
    if not isinstance(values, Sequence) or len(values) != 3 or not all(map(_is_coordinate, values)):
        raise InvalidValueError(f"an origin is three numbers within {_MAX_COORDINATE:g}, not {shown(values)}")
    x, y, z = (float(value) + 0.0 for value in values)  # no -0
    return x, y, z


def _is_coordinate(value: Any) -> bool:
    numbers = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return numbers and bool(abs(value) <= _MAX_COORDINATE)


def choose_origin(means: np.ndarray, *, low_thresholds: bool) -> Origin:
    """Chooses an origin for positions, so that float32 is precise enough for positions relative to the origin.

    Args:
        means: World coordinates, float (N, 3); rows that are not finite are ignored.
        low_thresholds: False to choose an origin only for scenes that are more than 256 times their spread and 1000
            units away from 0. True for more than 8 times and 16 units, and also for all scenes that float32 would round
            visibly.

    Returns:
        The origin; `NO_ORIGIN` if none is needed.

    Raises:
        InvalidValueError: If a coordinate of the origin would exceed the largest permitted value.
    """
    statistics = _middle_and_spread(means)
    if statistics is None:
        return NO_ORIGIN
    middle, far, spread = statistics
    ratio, min_distance = (_LOW_RATIO, _LOW_MIN_DISTANCE) if low_thresholds else (_HIGH_RATIO, _HIGH_MIN_DISTANCE)
    if far <= max(ratio * spread, min_distance) and not (low_thresholds and _is_far_and_small(far, spread)):
        return NO_ORIGIN
    return _rounded(middle, spread)


def choose_origin_of_small(means: np.ndarray) -> Origin:
    """Chooses an origin for float64 positions, only if rounding them to float32 without an origin would be visible.

    The rounding step of float32 grows with the distance from 0. This step is visible in a scene that is small compared
    with its distance from 0. Positions relative to an origin near the scene have a small step.

    Args:
        means: World coordinates, float64 (N, 3); rows that are not finite are ignored.

    Returns:
        The origin, near the median of the positions; `NO_ORIGIN` if float32 is precise enough without an origin.

    Raises:
        InvalidValueError: If a coordinate of the origin would exceed the largest permitted value.
    """
    statistics = _middle_and_spread(means)
    if statistics is None or not _is_far_and_small(statistics[1], statistics[2]):
        return NO_ORIGIN
    return _rounded(statistics[0], statistics[2])


def _middle_and_spread(means: np.ndarray) -> tuple[np.ndarray, float, float] | None:
    """Returns the median of positions and the size of the scene; None if no position is finite.

    Args:
        means: World coordinates, float (N, 3).

    Returns:
        Three values: the median position; the largest absolute coordinate of the median position; and the largest
        extent of all positions along an axis, without outliers.
    """
    sample = np.asarray(means[:: max(1, -(-len(means) // _SAMPLE))], np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample):
        return None
    middle = np.median(sample, axis=0)
    low, high = np.quantile(sample, _SPREAD_QUANTILES, axis=0)
    return middle, float(np.abs(middle).max()), float((high - low).max())


def _is_far_and_small(far: float, spread: float) -> bool:
    """True if rounding the positions of a scene to float32 would be visible.

    Args:
        far: Largest absolute coordinate of the median position.
        spread: Largest extent along an axis, in the same unit. If it is 0, the size of the scene is unknown, and the
            result is False.
    """
    return 0 < _PRECISE_RATIO * spread < far


def _rounded(middle: np.ndarray, spread: float) -> Origin:
    """Returns an origin near the median of positions, rounded to multiples of a step.

    The step is 1 for most scenes, and a smaller power of 2 for scenes below 1/64 of a unit. It may be larger than the
    scene, but it is at most `_MAX_STEP_SPREADS` spreads (or the spacing of float64 at the origin), so that float32
    positions relative to the origin are precise.

    Args:
        middle: The median position.
        spread: Largest extent of the scene along an axis, in the same unit; 0 if unknown.

    Raises:
        InvalidValueError: If a coordinate of the median exceeds the largest permitted value for an origin.
    """
    far = float(np.abs(middle).max())
    if far > _MAX_COORDINATE:
        raise InvalidValueError(
            f"positions are around {far:.4g} from 0, and origins end at {_MAX_COORDINATE:g}: subtract a point near them"
        )
    max_step = max(_MAX_STEP_SPREADS * spread, float(np.spacing(far)))
    step = min(1.0, 2.0 ** math.floor(math.log2(max_step))) if spread > 0 else 1.0
    return check_origin((np.rint(middle / step) * step).tolist())


def check_precision(means: np.ndarray, name: str) -> None:
    """Checks that positions passed by a caller lose no precision when they are converted to float32.

    Args:
        means: World coordinates, float (N, 3).
        name: Name of the argument, for the message.

    Raises:
        InvalidValueError: If the positions are float64 and far from 0; the message explains how to subtract an origin.
    """
    if means.dtype.itemsize <= 4 or not len(means):
        return
    finite = means[np.isfinite(means).all(axis=1)]
    far = float(np.abs(finite).max(initial=0.0))
    if choose_origin(means, low_thresholds=True) == NO_ORIGIN:
        return
    raise InvalidValueError(
        f"{name}: {means.dtype} coordinates up to {far:.6g}, which float32 would round to steps of "
        f"{float(np.spacing(np.float32(min(far, 1e38)))):.2g}: subtract an origin near them, `origin = "
        "tuple(np.median(means, axis=0).round().tolist())`, and state it: `SplatScene(Splats(means=(means - "
        "origin).astype(np.float32), ...), origin=origin)`"
    )


def misses_positions(origin: Origin, means: np.ndarray) -> float | None:
    """Returns the distance of an origin from the positions if this distance is too large for float32, else None.

    Positions relative to a distant origin are too imprecise in float32.

    Args:
        origin: The origin that a file declares.
        means: World coordinates, float64 (N, 3).

    Returns:
        Largest distance on an axis between the median position and the origin, world units. None if float32 is precise
        enough.
    """
    relative_positions = means - np.array(origin)
    if choose_origin(relative_positions, low_thresholds=False) == NO_ORIGIN:
        return None
    middle = np.median(relative_positions[np.isfinite(relative_positions).all(axis=1)], axis=0)
    return float(np.abs(middle).max())


def describe_origin(origin: Origin) -> str:
    """Formats an origin for messages and comments: three numbers without rounding."""
    return " ".join(str(int(value)) if value == math.floor(value) else repr(value) for value in origin)
