import numpy as np
import pytest

from splatwire.ops.order_statistics import middle_ranks, order_statistics, quantiles


def _values(kind: str, count: int, dtype: str) -> np.ndarray:
    rng = np.random.default_rng(count)
    values = rng.normal(size=count) * 10.0 ** rng.integers(-3, 3, count)
    return {"any": values, "ties": np.round(values), "one": np.full(count, -3.3)}[kind].astype(dtype)


@pytest.mark.parametrize("kind", ["any", "ties", "one"])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("count", [1, 2, 3, 70_001])
def test_order_statistics_equal_those_of_sorted_values(kind: str, dtype: str, count: int):
    values = _values(kind, count, dtype)
    pieces = lambda: (values[begin : begin + 20_000] for begin in range(0, count, 20_000))  # noqa: E731
    ranks = [0, count // 3, count - 1]
    assert order_statistics(pieces, ranks).tolist() == np.sort(values)[ranks].tolist()
    shares = [0.01, 0.5, 0.99]
    assert quantiles(pieces, count, shares).tolist() == np.quantile(values.astype(float), shares).tolist()
    assert order_statistics(pieces, middle_ranks(count)).mean() == np.median(values.astype(float))


def test_float64_numbers_that_differ_in_the_last_bits_are_distinguished():
    numbers = np.array([1.0 + 515 * 2.0**-52, 1.0, 1.0 + 7 * 2.0**-52])
    assert order_statistics(lambda: [numbers], [0, 1, 2]).tolist() == sorted(numbers.tolist())
