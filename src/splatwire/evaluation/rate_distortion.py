"""Rate-distortion curves and their mean differences (Bjontegaard deltas).

Curves are interpolated by monotone cubics (PCHIP) as in JCTVC-L1100, instead of the single cubic of the original method
(Bjontegaard, ITU-T VCEG-M33, 2001). Their difference is averaged over the range that both cover.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError

MIN_POINTS = 2
"""Minimum number of points of a curve; two points give a line over the logarithm of bytes."""


@dataclass(frozen=True)
class RatePoint:
    """One point of a rate-distortion curve.

    Attributes:
        num_bytes: Number of bytes that are sent.
        quality: Quality at this rate, higher is better, such as PSNR in decibels.
    """

    num_bytes: int
    quality: float

    def __post_init__(self) -> None:
        if self.num_bytes < 1 or not math.isfinite(self.quality):
            given = f"{self.num_bytes} bytes and {self.quality:g}"
            raise InvalidValueError(f"a point needs a positive number of bytes and a finite quality, not {given}")


@checked
def bd_rate(reference: Sequence[RatePoint], other: Sequence[RatePoint]) -> float | None:
    """Computes the mean relative difference of bytes at equal quality (BD-rate).

    Args:
        reference: Points of the reference curve, in any order.
        other: Points of the other curve.

    Returns:
        Bytes of the other curve relative to the reference, minus 1: -0.5 for half the bytes. None if the curves have no
        common range of quality.
    """
    difference = _mean_difference(*([(p.quality, math.log(p.num_bytes)) for p in c] for c in (reference, other)))
    return None if difference is None else math.expm1(difference)


@checked
def bd_quality(reference: Sequence[RatePoint], other: Sequence[RatePoint]) -> float | None:
    """Computes the mean difference of quality at equal bytes (BD-PSNR, if the quality is PSNR).

    Args:
        reference: Points of the reference curve, in any order.
        other: Points of the other curve.

    Returns:
        Quality of the other curve minus that of the reference. None if the curves have no common range of bytes.
    """
    # The sign makes the better one of two points with equal bytes the one that is kept.
    difference = _mean_difference(*([(math.log(p.num_bytes), -p.quality) for p in c] for c in (reference, other)))
    return None if difference is None else -difference


def _mean_difference(reference: Iterable[tuple[float, float]], other: Iterable[tuple[float, float]]) -> float | None:
    """Returns the mean difference of two curves over their common range of x, or None without a common range.

    Args:
        reference: Points (x, y) of the curve that is subtracted.
        other: Points (x, y) of the other curve.
    """
    from scipy.interpolate import PchipInterpolator  # takes long to load

    curves = [_sorted_points(points) for points in (reference, other)]
    if min(map(len, curves)) < MIN_POINTS:
        return None
    low, high = max(curve[0][0] for curve in curves), min(curve[-1][0] for curve in curves)
    if not low < high:
        return None
    areas = [float(PchipInterpolator(*zip(*curve, strict=True)).integrate(low, high)) for curve in curves]
    return (areas[1] - areas[0]) / (high - low)


def _sorted_points(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Sorts the points (x, y) of a curve by x, and keeps only the lowest point for each x."""
    groups = itertools.groupby(sorted(points), key=lambda point: point[0])
    return [next(group) for _, group in groups]
