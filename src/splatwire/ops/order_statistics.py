"""Exact order statistics (such as medians) of numbers that are read in several passes, in constant memory."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from splatwire.ops._order_kernels import count_digits

DIGIT_BITS = 11
Pieces = Callable[[], Iterable[np.ndarray]]
"""Function that starts a new pass over the numbers: yields one-dimensional arrays, float32 or float64, without NaN."""


def order_statistics(pieces: Pieces, ranks: Sequence[int]) -> np.ndarray:
    """Returns the numbers that sorting would put at given positions, without sorting (radix selection).

    Args:
        pieces: Function that yields the unsorted numbers, one array after another; called several times.
        ranks: Positions in the sorted sequence from 0, each below the count of numbers.

    Returns:
        The number at each position, float64.
    """
    values, remaining = [0] * len(ranks), list(ranks)
    shift = size = 8 * next(iter(pieces())).dtype.itemsize
    while shift:
        bits = min(DIGIT_BITS, shift)
        shift -= bits
        prefixes = np.unique(np.array(values, dtype=f"u{size // 8}"))
        counts = np.zeros((len(prefixes), 1 << bits), np.int64)
        for piece in pieces():
            count_digits(np.ascontiguousarray(piece).view(prefixes.dtype), prefixes, shift, bits, counts)
        for i, prefix in enumerate(values):
            upto = np.cumsum(counts[np.searchsorted(prefixes, prefixes.dtype.type(prefix))])
            digit = int(np.searchsorted(upto, remaining[i], side="right"))
            remaining[i] -= int(upto[digit - 1]) if digit else 0
            values[i] = prefix << bits | digit
    return _numbers(np.array(values, dtype=f"u{size // 8}"))


def middle_ranks(count: int) -> list[int]:
    """Returns the positions of the two middle numbers among `count` sorted numbers; their mean is the median."""
    return [(count - 1) // 2, count // 2]


def quantiles(pieces: Pieces, count: int, probabilities: Sequence[float]) -> np.ndarray:
    """Computes the quantiles of numbers that need not fit in memory; same results as `np.quantile`.

    Args:
        pieces: Function that yields the numbers, one array after another; called several times.
        count: Total number of numbers.
        probabilities: The quantiles to compute, from 0 to 1.

    Returns:
        The quantiles, linearly interpolated, float64.
    """
    at = (count - 1) * np.array(probabilities)
    low = np.floor(at).astype(int)
    ends = order_statistics(pieces, [*low.tolist(), *np.minimum(low + 1, count - 1).tolist()])
    a, b, t = ends[: len(at)], ends[len(at) :], at - low
    return np.where(t < 0.5, a + (b - a) * t, b - (b - a) * (1 - t))


def _numbers(keys: np.ndarray) -> np.ndarray:
    """Converts sort keys back to floating-point numbers, as float64.

    A sort key is an unsigned integer with the bits of a float32 or float64 number: with the sign bit inverted if the
    number is positive, and with all bits inverted if it is negative. Keys have the same order as the numbers.

    Args:
        keys: The keys, uint32 or uint64.
    """
    top = keys.dtype.type(1 << (8 * keys.dtype.itemsize - 1))
    return np.where(keys & top, keys ^ top, ~keys).view(f"f{keys.dtype.itemsize}").astype(np.float64)
