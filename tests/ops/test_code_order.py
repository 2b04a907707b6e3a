import tracemalloc

import numpy as np
import pytest

from splatwire.ops.code_order import SOME, code_order


def _codes(kind: str, count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    return {
        "any": rng.integers(0, 1 << 63, count),
        "few": rng.integers(0, 5, count) << 40,
        "one": np.full(count, 77),
        "close": rng.integers(0, 1 << 20, count) | 1 << 60,
    }[kind]


@pytest.mark.parametrize("kind", ["any", "few", "one", "close"])
@pytest.mark.parametrize("count", [0, 1, 5, 3 * SOME + 1])
def test_code_order_equals_a_stable_sort(kind: str, count: int):
    codes = _codes(kind, count)
    assert code_order(codes, 63).tolist() == np.argsort(codes, kind="stable").tolist()
    groups = (np.arange(count) % 5 // 2).astype(np.uint8)
    found = code_order(codes, 63, groups)
    assert found.tolist() == np.lexsort((codes, groups)).tolist()


def test_numpy_allocates_little_besides_the_order():
    """Bounds the memory of numpy's arrays; `tracemalloc` does not count what compiled kernels allocate."""
    count = 3_000_000
    codes = np.arange(count) * 0x9E3779B1 & (1 << 32) - 1
    tracemalloc.start()
    order = code_order(codes, 32)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert order.nbytes == 4 * count
    assert peak < order.nbytes + 10_000_000
