"""Bjontegaard differences: laws, an independent integration, and published benchmarks of this repository."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from splatwire.errors import InvalidValueError
from splatwire.evaluation.rate_distortion import RatePoint, bd_quality, bd_rate

RESULTS = Path(__file__).parents[2] / "benchmarks/results"


def curve(*points: tuple[int, float]) -> list[RatePoint]:
    return [RatePoint(*point) for point in points]


REFERENCE = curve((100, 30.0), (200, 32.5), (400, 34.0), (800, 35.1))
BENT = curve((90, 30.4), (210, 33.0), (380, 33.9), (900, 36.0))


def test_bd_rate_of_a_curve_against_itself_is_zero():
    assert bd_rate(REFERENCE, REFERENCE) == 0
    assert bd_quality(REFERENCE, REFERENCE) == 0


def test_curve_with_half_the_bytes_has_a_bd_rate_of_minus_one_half():
    half = [RatePoint(p.num_bytes // 2, p.quality) for p in REFERENCE]
    assert bd_rate(REFERENCE, half) == pytest.approx(-0.5, abs=1e-12)
    assert bd_rate(half, REFERENCE) == pytest.approx(1.0, abs=1e-12)


def test_curve_with_one_decibel_more_has_a_bd_quality_of_one():
    better = [RatePoint(p.num_bytes, p.quality + 1) for p in REFERENCE]
    assert bd_quality(REFERENCE, better) == pytest.approx(1.0, abs=1e-12)
    assert bd_quality(better, REFERENCE) == pytest.approx(-1.0, abs=1e-12)


def test_exchanged_curves_have_the_inverse_ratio_of_bytes():
    there, back = bd_rate(REFERENCE, BENT), bd_rate(BENT, REFERENCE)
    assert there is not None
    assert back is not None
    assert (1 + there) * (1 + back) == pytest.approx(1)


def test_order_of_points_has_no_effect():
    assert bd_rate(REFERENCE[::-1], BENT[::2] + BENT[1::2]) == bd_rate(REFERENCE, BENT)
    assert bd_quality(REFERENCE[::-1], BENT[::2] + BENT[1::2]) == bd_quality(REFERENCE, BENT)


def hermite(points: list[tuple[float, float]], x: float) -> float:
    """Piecewise cubic of Fritsch and Carlson with three-point slopes at the ends, from its published equations."""
    xs, ys = np.array(sorted(points)).T
    h, d = np.diff(xs), np.diff(ys) / np.diff(xs)
    slopes = [_end(h[0], h[1], d[0], d[1])]
    for i in range(1, len(xs) - 1):
        w, v = 2 * h[i] + h[i - 1], h[i] + 2 * h[i - 1]
        slopes.append(0.0 if d[i - 1] * d[i] <= 0 else (w + v) / (w / d[i - 1] + v / d[i]))
    slopes.append(_end(h[-1], h[-2], d[-1], d[-2]))
    i = min(int(np.searchsorted(xs, x, "right")) - 1, len(h) - 1)
    t = (x - xs[i]) / h[i]
    return float(
        (2 * t**3 - 3 * t**2 + 1) * ys[i]
        + (t**3 - 2 * t**2 + t) * h[i] * slopes[i]
        + (3 * t**2 - 2 * t**3) * ys[i + 1]
        + (t**3 - t**2) * h[i] * slopes[i + 1]
    )


def _end(h0: float, h1: float, d0: float, d1: float) -> float:
    slope = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    if slope * d0 <= 0:
        return 0.0
    return 3 * d0 if d0 * d1 <= 0 and abs(slope) > 3 * abs(d0) else slope


def test_bd_rate_equals_an_independent_integration():
    x = np.linspace(30.4, 35.1, 20_001)
    one, two = ([(p.quality, math.log(p.num_bytes)) for p in points] for points in (REFERENCE, BENT))
    differences = [hermite(two, value) - hermite(one, value) for value in x]
    expected = math.expm1(np.trapezoid(differences, x) / (x[-1] - x[0]))
    assert bd_rate(REFERENCE, BENT) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("scene", ["lego", "snowmiku_small", "bonsai_small"])
def test_published_bd_rates_are_repeated(scene):
    found = json.loads((RESULTS / "causal.json").read_text())[scene]
    one, two = (
        [RatePoint(row["bytes"], row["psnr"]) for row in found["scenes"] if row["model"] == model]
        for model in ("hacpp", "causal")
    )
    assert bd_rate(one, two) == pytest.approx(found["bd_rate"], rel=1e-9)


def test_curves_without_a_common_range_have_no_difference():
    far = [RatePoint(p.num_bytes * 100, p.quality + 20) for p in REFERENCE]
    assert bd_rate(REFERENCE, far) is None
    assert bd_quality(REFERENCE, far) is None


def test_bd_rate_needs_two_different_points():
    assert bd_rate(REFERENCE, REFERENCE[:1]) is None
    assert bd_rate(REFERENCE, curve((100, 31.0), (200, 31.0))) is None
    line = curve((100, 30.0), (400, 34.0))
    assert bd_rate(line, curve((200, 32.0), (800, 36.0))) == pytest.approx(0.0)


def test_better_one_of_two_points_counts():
    """Of equal qualities the smaller, of equal sizes the better."""
    assert bd_rate(REFERENCE, [*REFERENCE, RatePoint(500, 34.0)]) == 0
    assert bd_quality(REFERENCE, [*REFERENCE, RatePoint(400, 33.0)]) == 0


@pytest.mark.parametrize(("num_bytes", "quality"), [(0, 30.0), (-1, 30.0), (1, math.inf), (1, math.nan)])
def test_points_without_bytes_or_quality_are_refused(num_bytes, quality):
    with pytest.raises(InvalidValueError, match="positive number of bytes"):
        RatePoint(num_bytes, quality)
