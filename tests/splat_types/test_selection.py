"""Selections of Gaussians, scenes and cameras."""

import numpy as np
import pytest

from explicit import ball_of_gaussians
from scenes import tiny_cameras
from splatwire.errors import InvalidValueError
from splatwire.types import SplatScene


@pytest.mark.parametrize("index", [[3, 0], (3, 0), np.array([3, 0], np.uint8), np.array([-197, 0]), slice(3, None, -3)])
def test_selections_of_every_kind_are_equal(index) -> None:
    splats, cameras = ball_of_gaussians(), tiny_cameras(200, 8, 8)
    assert splats.select(index).means.tolist() == splats.means[[3, 0]].tolist()
    assert splats.gathered(index).means.tolist() == splats.means[[3, 0]].tolist()
    assert SplatScene(splats).select(index).num_elements == 2
    assert cameras.select(index).names == (cameras.names[3], cameras.names[0])


def test_masks_and_empty_selections() -> None:
    splats, mask = ball_of_gaussians(), np.arange(200) % 3 == 0
    assert splats.select(mask).means.tolist() == splats.means[mask].tolist()
    assert splats.select(mask.tolist()).num_gaussians == mask.sum()
    assert splats.select([]).num_gaussians == splats.select(np.zeros(0)).num_gaussians == 0


@pytest.mark.parametrize(
    "index",
    [
        np.array([True, False]), np.ones(201, np.bool_), np.zeros(0, np.bool_), [200], [-201], 3, None, "a", [1.0],
        [[1]], [[1], [1, 2]], slice("a", None), slice(None, None, 0),
    ],
)  # fmt: skip
def test_wrong_selections_are_an_error(index) -> None:
    """A mask of another length would select other Gaussians without a word."""
    for chosen in (ball_of_gaussians(), SplatScene(ball_of_gaussians()), tiny_cameras(200, 8, 8)):
        with pytest.raises(InvalidValueError, match="index: expected"):
            chosen.select(index)


def test_errors_of_selections_name_the_accepted_indices() -> None:
    splats = ball_of_gaussians()
    with pytest.raises(InvalidValueError, match="numbers from -200 to 199, not 200 to 200"):
        splats.select([200])
    with pytest.raises(InvalidValueError, match="expected none, as there are no elements, not 0 to 0"):
        splats.select([]).select([0])
