import math

import pytest

from splatwire.rate_control.search import TRIALS, Interval, search

CURVES = {
    "straight": lambda x: 3 * x,
    "steep": lambda x: math.exp(x),
    "flat": lambda x: math.log(x + 3),
    "kinked": lambda x: x if x < 4 else 4 + 20 * (x - 4),
}


@pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)
@pytest.mark.parametrize("at", [2.6, 3.9, 4.05, 7.0, 9.9])
@pytest.mark.parametrize("slope", [0.2, 1.0, 30.0])
def test_search_finds_a_permitted_value_of_increasing_functions(curve, at, slope):
    seen = []

    def function(x: float) -> float:
        seen.append(x)
        return curve(x)

    wanted = curve(at)
    off = 0.015 * wanted
    found = search(function, Interval(wanted - off, wanted, wanted + off), 5.0, slope, (2.0, 10.0))
    assert found == seen[-1]
    assert abs(curve(found) - wanted) <= off
    assert len(seen) <= TRIALS
    assert all(2 <= x <= 10 for x in seen)


@pytest.mark.parametrize(("wanted", "end"), [(-5.0, 2.0), (50.0, 10.0)])
def test_search_beyond_the_ends_tries_the_end_and_finds_nothing(wanted, end):
    seen = []

    def function(x: float) -> float:
        seen.append(x)
        return x

    assert search(function, Interval(wanted - 1, wanted, wanted + 1), 5.0, 1.0, (2.0, 10.0)) is None
    assert end in seen
