"""The kernel that applies motion to base Gaussians equals plain numpy."""

import numpy as np
import pytest

from close import assert_close, unit
from random_numbers import Numbers
from reference.moved import moved as plain
from splatwire.sequence.decoding import apply_motion
from splatwire.types.splats import Splats


@pytest.mark.parametrize("degree", [0, 2])
def test_poses_equal_the_numpy_reference(degree):
    rng = Numbers(degree)
    scales = rng.rand(40, 3) + 0.01
    scales[:9] = np.tile(np.float32([[1, 1, 0.5], [0.5, 1, 1], [1, 0.5, 1]]), (3, 1))  # equal ones in order
    quats = unit(rng.randn(40, 4))
    sh = rng.randn(40, (degree + 1) ** 2, 3)
    splats = Splats(rng.randn(40, 3), quats, scales, rng.rand(40), sh)
    offsets = rng.randn(60, 13)
    offsets[::3] = 0
    offsets[:4, 9] = 50.0
    tracks = np.random.default_rng(degree).integers(0, 40, 60)
    found, expected = apply_motion(splats, tracks, offsets), plain(splats.select(tracks), offsets)
    for name, values in vars(found).items():
        assert_close(values, getattr(expected, name), rtol=2e-5, atol=2e-6)
    still = apply_motion(splats, np.arange(40), np.zeros((40, 13), np.float32))
    for name in ("means", "scales", "opacities", "sh"):
        assert np.array_equal(getattr(still, name), getattr(splats, name))


def test_arbitrary_changes_of_scales_stay_finite():
    splats = Splats(np.zeros((1, 3)), np.float32([[1, 0, 0, 0]]), np.ones((1, 3)), np.ones(1), np.zeros((1, 1, 3)))
    offsets = np.zeros((1, 13), np.float32)
    offsets[0, 6:9] = 200.0, 0.0, -200.0
    scales = apply_motion(splats, np.zeros(1, np.int64), offsets).scales
    assert np.isfinite(scales).all()
    assert scales.max() == np.finfo(np.float32).max
