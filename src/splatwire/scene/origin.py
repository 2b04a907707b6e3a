"""Origins of geo-referenced scenes: positions are float32 relative to a point whose coordinates are float64.

Adjacent float32 numbers differ by half a metre at coordinates of maps (UTM, ECEF: up to 7e6 m). The
origin is subtracted in float64 and kept with the Gaussians.
"""

import math
from collections.abc import Sequence

import numpy as np

from splatwire.errors import InvalidValueError

Origin = tuple[float, float, float]
"""World coordinates of the point that positions are relative to, float64."""
NO_ORIGIN: Origin = (0.0, 0.0, 0.0)
"""Origin of scenes with positions in world coordinates."""
_MAX_COORDINATE = 1e12
"""Largest coordinate of an origin."""
_SAMPLE = 1 << 16
"""Maximum number of positions that an origin is chosen from."""
_SPREAD_QUANTILES = (0.05, 0.95)
"""The distance of these quantiles is the spread of positions: single Gaussians far away do not change it."""
_WIDE_RATIO, _WIDE_LEAST = 8.0, 16.0
"""For float64 positions: distance from 0 over spread, and least distance, above which an origin is used."""
_NARROW_RATIO, _NARROW_LEAST = 256.0, 1000.0
"""The same for float32 positions: their precision is lost already, so only formats of fewer bits gain."""


def check_origin(values: object) -> Origin:
    """Returns an origin that was read from a file.

    Raises:
        InvalidValueError: If `values` is not three finite numbers of at most 1e12.
    """
    if (
        not isinstance(values, Sequence)
        or len(values) != 3
        or not all(type(value) in (int, float) and abs(value) <= _MAX_COORDINATE for value in values)
    ):
        raise InvalidValueError(f"an origin is three numbers within {_MAX_COORDINATE:g}, not {values!r:.80}")
    x, y, z = (float(value) + 0.0 for value in values)  # no -0
    return x, y, z


def choose_origin(means: np.ndarray, *, wide: bool) -> Origin:
    """Chooses the origin of positions: the median in whole units if it is far from 0 compared with the spread.

    Args:
        means: World coordinates, float (N, 3); rows that are not finite are ignored.
        wide: True if positions are more precise than float32.

    Returns:
        The origin; `NO_ORIGIN` where none is needed.
    """
    some = np.asarray(means[:: max(1, -(-len(means) // _SAMPLE))], np.float64)
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some):
        return NO_ORIGIN
    middle = np.median(some, axis=0)
    low, high = np.quantile(some, _SPREAD_QUANTILES, axis=0)
    far, spread = float(np.abs(middle).max()), float((high - low).max())
    ratio, least = (_WIDE_RATIO, _WIDE_LEAST) if wide else (_NARROW_RATIO, _NARROW_LEAST)
    if not max(ratio * spread, least) < far <= _MAX_COORDINATE:
        return NO_ORIGIN
    return check_origin(np.rint(middle).tolist())


def describe_origin(origin: Origin) -> str:
    """Formats an origin for messages and comments: three numbers that parse to the same float64."""
    return " ".join(str(int(value)) if value == math.floor(value) else repr(value) for value in origin)
