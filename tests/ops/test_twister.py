"""Numbers that are the same in every release."""

import numpy as np
import pytest

from splatwire.ops.twister import Twister


@pytest.mark.parametrize("count", [16, 48, 61, 1000])
def test_the_sequences_are_those_of_torch(count: int) -> None:
    torch = pytest.importorskip("torch")
    ours, theirs = Twister(5), torch.Generator().manual_seed(5)
    np.testing.assert_allclose(ours.normal(count), torch.randn(count, generator=theirs).numpy(), atol=1e-6)
    assert np.array_equal(ours.uniform(7), torch.rand(7, generator=theirs).numpy())
    signs = torch.randint(0, 2, (3, 5), generator=theirs) * 2 - 1
    assert np.array_equal(ours.signs((3, 5)), signs.numpy())


def test_normal_numbers_are_pinned() -> None:
    first = [-1.1258398, -1.1523602, -0.25057858, -0.4338788]
    np.testing.assert_allclose(Twister(0).normal(40)[:4], first, atol=1e-6)
    np.testing.assert_allclose(Twister(0).normal(3), Twister(0).normal(16)[:3])
    many = Twister(1).normal(100_000)
    assert abs(float(many.mean())) < 0.01
    assert abs(float(many.std()) - 1) < 0.01
