"""Thumbnails of scenes."""

from dataclasses import replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.codec.initial_view import InitialView
from splatwire.evaluation.thumbnail import thumbnail
from splatwire.types import SplatScene


@pytest.mark.parametrize("ahead", [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)])
def test_a_view_along_the_up_direction_is_drawn(ahead):
    eye = tuple(-3.0 * value for value in ahead)
    picture = thumbnail(SplatScene(ball_of_gaussians()), (32, 24), InitialView(eye, (0.0, 0.0, 0.0), ahead))
    assert picture.shape == (24, 32, 3)
    assert np.ptp(picture) > 50


@pytest.mark.parametrize("view", [None, InitialView((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))])
def test_thumbnails_do_not_depend_on_the_unit_of_length(view):
    ball, factor = ball_of_gaussians(), 2.0**-10
    small = replace(ball, means=ball.means * np.float32(factor), scales=ball.scales * np.float32(factor))
    near = view and InitialView(tuple(factor * value for value in view.eye), *view[1:])
    wanted = thumbnail(SplatScene(ball), (48, 32), view)
    assert np.ptp(wanted) > 50
    assert np.abs(thumbnail(SplatScene(small), (48, 32), near).astype(int) - wanted).max() <= 1
