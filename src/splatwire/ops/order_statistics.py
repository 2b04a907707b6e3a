"""Exact order statistics (such as medians) of numbers that are read in several passes, in constant memory."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

DIGIT_BITS = 16
Pieces = Callable[[], Iterable[np.ndarray]]
"""Function that starts a new pass over the numbers: yields one-dimensional arrays, float32 or float64, without NaN."""


def order_statistics(pieces: Pieces, ranks: Sequence[int]) -> np.ndarray:
    """Returns the numbers at given positions of a sorted sequence, without sorting it (radix selection).

    Args:
        pieces: Function that yields the unsorted numbers, one array after another; called several times.
        ranks: Positions in the sorted sequence from 0, each below the count of numbers.

    Returns:
        The number at each position, float64.
    """
    found, left, bits = [0] * len(ranks), list(ranks), 0
    shift = size = 8 * next(iter(pieces())).dtype.itemsize
    while shift:
        shift -= DIGIT_BITS
        counts = {prefix: np.zeros(1 << DIGIT_BITS, np.int64) for prefix in found}
        for piece in pieces():
            keys = _keys(piece)
            for prefix, count in counts.items():
                here = keys[keys >> (shift + DIGIT_BITS) == prefix] if bits else keys
                count += np.bincount((here >> shift).astype(np.uint16), minlength=1 << DIGIT_BITS)
        bits += DIGIT_BITS
        for i, prefix in enumerate(found):
            upto = np.cumsum(counts[prefix])
            digit = int(np.searchsorted(upto, left[i], side="right"))
            left[i] -= int(upto[digit - 1]) if digit else 0
            found[i] = prefix << DIGIT_BITS | digit
    return _numbers(np.array(found, dtype=f"u{size // 8}"))


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


def _keys(values: np.ndarray) -> np.ndarray:
    """Maps floats to unsigned integers that sort in the same order."""
    # Of positive floats the sign bit is inverted, of negative floats all bits.
    bits = np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")
    top = bits.dtype.type(1 << (8 * values.dtype.itemsize - 1))
    return np.where(bits & top, ~bits, bits | top)


def _numbers(keys: np.ndarray) -> np.ndarray:
    """Converts sortable integers, the results of `_keys`, back to the floating-point numbers they encode, float64."""
    top = keys.dtype.type(1 << (8 * keys.dtype.itemsize - 1))
    return np.where(keys & top, keys ^ top, ~keys).view(f"f{keys.dtype.itemsize}").astype(np.float64)
