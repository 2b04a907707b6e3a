"""Kernels on sixteen floats at a time against numpy, one function at a time."""

import numba
import numpy as np
import pytest

from splatwire.ops import lanes


@numba.njit
def _powers(values, out):  # type: ignore[no-untyped-def]
    for i in range(0, values.shape[0], 16):
        lanes.store(out, i, lanes.power_of_two(lanes.load(values, i)))


@numba.njit
def _arithmetic(a, b, c, out):  # type: ignore[no-untyped-def]
    x, y = lanes.load(a, 0), lanes.load(b, 0)
    both = (x >= y) & (x <= c)
    lanes.store(out, 0, lanes.choose(both, x * y - c, lanes.smaller(x, y) / (c + y)))
    x += lanes.spread(c)
    lanes.store(out, 16, c - x)


@numba.njit
def _totals(rows, out):  # type: ignore[no-untyped-def]
    a, b = lanes.load(rows, 0), lanes.load(rows, 16)
    two = lanes.pairs(a, b)
    two = lanes.pairs(two, two)
    two = lanes.pairs(two, two)
    lanes.prefetch(rows, 16)
    lanes.store_first(out, 1, lanes.pairs(two, two), 2)


def test_powers_of_two_are_near_exact_over_the_whole_range() -> None:
    values = np.linspace(-125.5, 126.5, 160_000, dtype=np.float32)
    out = np.empty_like(values)
    _powers(values, out)
    exact = np.exp2(values.astype(np.float64))
    assert np.abs(out / exact - 1).max() < 2.5e-7


@pytest.mark.parametrize("seed", range(3))
def test_arithmetic_and_masks_equal_numpy(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 16)).astype(np.float32)
    c, out = np.float32(0.7), np.empty(32, np.float32)
    _arithmetic(a, b, c, out)
    expected = np.where((a >= b) & (a <= c), a * b - c, np.minimum(a, b) / (c + b))
    np.testing.assert_allclose(out[:16], expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(out[16:], c - (a + c), rtol=1e-5, atol=1e-6)


def test_totals_are_stored_at_their_index_only() -> None:
    rows, out = np.arange(32, dtype=np.float32), np.full(5, -1, np.float32)
    _totals(rows, out)
    assert out.tolist() == [-1, rows[:16].sum(), rows[16:].sum(), -1, -1]
