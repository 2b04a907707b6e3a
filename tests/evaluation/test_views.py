import itertools

import numpy as np
import pytest

from scenes import tiny_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluation import ReferenceViews
from splatwire.evaluation.views import spread


@pytest.mark.parametrize(("num", "count"), [(13, 4), (13, 13), (13, 40), (1, 1), (7, 2)])
def test_chosen_views_are_evenly_spread_and_distinct(num, count):
    views = spread(num, count)
    assert len(views) == len(set(views)) == min(num, count)
    assert views[0] == 0
    gaps = [b - a for a, b in itertools.pairwise(views)]
    assert not gaps or max(gaps) - min(gaps) <= 1


def test_choosing_all_views_returns_every_view():
    assert spread(5, None) == [0, 1, 2, 3, 4]


def test_references_of_another_size_are_refused():
    cameras = tiny_cameras(1, 40, 32)
    views = ReferenceViews(cameras, lambda view: np.zeros((31, 40, 3), np.float32), "photos")
    with pytest.raises(InvalidValueError, match="view_00"):
        views.reference(0)
