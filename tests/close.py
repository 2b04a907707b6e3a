"""Comparison of arrays with tolerances for float32."""

from typing import Any

import numpy as np

from splatwire.ops.arrays import to_numpy


def assert_close(actual: Any, expected: Any, rtol: float = 1.3e-6, atol: float = 1e-5, **options: Any) -> None:
    """Fails unless two arrays or tensors of one shape agree to `atol + rtol * abs(expected)`."""
    ours, theirs = to_numpy(actual), to_numpy(expected)
    assert ours.shape == theirs.shape, (ours.shape, theirs.shape)
    np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=atol, **options)


def unit(values: np.ndarray) -> np.ndarray:
    """Rows (N, D) divided by their length."""
    return values / np.linalg.norm(values, axis=1, keepdims=True)
