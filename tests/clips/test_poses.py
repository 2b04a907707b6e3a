"""How Gaussians differ from their bases: the kernel against plain torch."""

import numpy as np
import pytest
import torch

from close import assert_close, unit
from reference.moved import moved as plain
from splatwire.clips.decoding import moved
from splatwire.scene.splats import Splats


@pytest.mark.parametrize("degree", [0, 2])
def test_gaussians_move_as_in_plain_torch(degree):
    rng = torch.Generator().manual_seed(degree)
    scales = torch.rand(40, 3, generator=rng).numpy() + 0.01
    scales[:9] = np.tile(np.float32([[1, 1, 0.5], [0.5, 1, 1], [1, 0.5, 1]]), (3, 1))  # equal ones in order
    quats = unit(torch.randn(40, 4, generator=rng).numpy())
    sh = torch.randn(40, (degree + 1) ** 2, 3, generator=rng).numpy()
    splats = Splats(torch.randn(40, 3, generator=rng).numpy(), quats, scales, torch.rand(40, generator=rng).numpy(), sh)
    offsets = torch.randn(60, 13, generator=rng).numpy()
    offsets[::3] = 0
    offsets[:4, 9] = 50.0
    tracks = np.random.default_rng(degree).integers(0, 40, 60)
    found, expected = moved(splats, tracks, offsets), plain(splats.select(tracks), offsets)
    for name, values in vars(found).items():
        assert_close(values, getattr(expected, name), rtol=2e-5, atol=2e-6)
    still = moved(splats, np.arange(40), np.zeros((40, 13), np.float32))
    for name in ("means", "scales", "opacities", "sh"):
        assert np.array_equal(getattr(still, name), getattr(splats, name))
