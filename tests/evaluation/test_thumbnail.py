"""Thumbnails of scenes."""

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.codec.viewpoint import Viewpoint
from splatwire.evaluation.thumbnail import thumbnail
from splatwire.types import SplatScene


@pytest.mark.parametrize("ahead", [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)])
def test_a_view_along_the_up_direction_is_drawn(ahead):
    eye = tuple(-3.0 * value for value in ahead)
    picture = thumbnail(SplatScene(ball_of_gaussians()), (32, 24), Viewpoint(eye, (0.0, 0.0, 0.0), ahead))
    assert picture.shape == (24, 32, 3)
    assert np.ptp(picture) > 50
