"""The kernel of the colours that a camera sees equals the numpy version exactly."""

import numpy as np
import pytest

from splatwire.types import splats as module
from splatwire.types.splats import Splats


def gaussians(count: int, degree: int) -> Splats:
    rng = np.random.default_rng(degree)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, (degree + 1) ** 2, 3))
    return Splats(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


@pytest.mark.parametrize("degree", range(4))
def test_the_kernel_equals_numpy(degree: int) -> None:
    splats, center = gaussians(1000, degree), np.array([0.3, -2, 1], np.float32)
    splats.means[0] = center
    splats.means[1] = 3e38  # the distance overflows
    splats.means[2], splats.means[3], splats.sh[4] = np.inf, np.nan, np.nan
    with np.errstate(over="ignore", invalid="ignore"):
        expected = module._colors(splats, center)
    np.testing.assert_array_equal(module._compiled_colors(splats, center), expected)
    np.testing.assert_array_equal(splats.seen_from(center).colors, expected)


def test_other_layouts_give_the_same_colours() -> None:
    splats, center = gaussians(300, 3), np.array([0, 1, 2], np.float32)
    lower, columns = splats.at_most_degree(1), Splats(**{k: np.asfortranarray(v) for k, v in vars(splats).items()})
    for some in (lower, columns):
        assert module._compiled_colors(some, center) is None
        np.testing.assert_array_equal(some.seen_from(center).colors, module._colors(some, center))
