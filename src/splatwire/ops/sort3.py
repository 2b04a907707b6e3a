"""Sorting of three numbers per row, vectorised."""

import numpy as np


def sort3(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sorts three numbers per row: returns minimum, median and maximum.

    Args:
        values: (N, 3), none of them NaN.

    Returns:
        Minimum, median and maximum of each row, three arrays (N).
    """
    a, b, c = np.ascontiguousarray(values.T)
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.minimum(low, c), np.maximum(low, np.minimum(high, c)), np.maximum(high, c)
