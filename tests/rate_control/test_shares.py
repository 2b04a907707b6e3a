"""Search for the share of Gaussians to keep before fine-tuning."""

import math

import pytest

from splatwire.rate_control.search import Interval
from splatwire.rate_control.shares import TUNINGS, search_share

AIM = Interval(40.0, 40.2, 40.4)


def searched(slope: float, at_half: float, start: float, aim: Interval = AIM) -> tuple[int, list[float], list[float]]:
    """Result of a search, with the tried shares and their values; the value is `at_half` for half of the Gaussians."""
    shares: list[float] = []
    values: list[float] = []

    def tune(share: float) -> float:
        shares.append(share)
        values.append(at_half + slope * math.log(2 * share))
        return values[-1]

    return search_share(tune, aim, start, 6.0), shares, values


@pytest.mark.parametrize("slope", [3.5, 6.0, 11.0])
@pytest.mark.parametrize("start", [0.3, 0.5, 0.7])
def test_aim_is_reached_with_three_fine_tunings(slope, start):
    best, _, values = searched(slope, 40.1, start)
    assert values[best] in AIM
    assert len(values) <= TUNINGS


def test_one_fine_tuning_is_enough_if_it_reaches_the_aim():
    assert searched(6.0, 40.3, 0.5) == (0, [0.5], [40.3])


def test_best_has_the_smallest_share_of_those_that_reach_the_aim():
    best, shares, values = searched(40.0, 41.0, 0.7)
    assert values[best] >= AIM.low
    assert shares[best] == min(share for share, value in zip(shares, values, strict=True) if value >= AIM.low)


def test_best_has_the_largest_value_if_none_reaches_the_aim():
    best, shares, values = searched(6.0, 30.0, 0.2)
    assert values[best] == max(values) < AIM.low
    assert max(shares) <= 1


def test_infinite_values_end_with_the_smallest_share():
    best, shares, values = searched(6.0, math.inf, 0.5)
    assert values == [math.inf] * TUNINGS
    assert shares == sorted(shares, reverse=True)
    assert best == TUNINGS - 1


def test_search_ends_if_all_gaussians_are_too_few():
    assert searched(6.0, 30.0, 1.0)[1] == [1.0]
