"""Exact order statistics of numbers that are read in pieces several times: memory does not grow with them."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

DIGIT_BITS = 16
Pieces = Callable[[], Iterable[np.ndarray]]
"""Reads numbers from the beginning: one-dimensional pieces, float32 or float64, none of them NaN."""


def order_statistics(pieces: Pieces, ranks: Sequence[int]) -> np.ndarray:
    """Numbers that would be at some places if all were sorted: found digit by digit from counts, the highest first.

    Args:
        pieces: The numbers; they are read twice if they are float32, four times if float64.
        ranks: Places from 0, each below how many numbers there are.

    Returns:
        float64, one for each rank.
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
    """Ranks of the two numbers, or twice of the one, that the median of `count` numbers is the mean of."""
    return [(count - 1) // 2, count // 2]


def quantiles(pieces: Pieces, count: int, shares: Sequence[float]) -> np.ndarray:
    """Quantiles of `count` numbers, in a straight line between the two nearest, bit for bit those of `np.quantile`."""
    at = (count - 1) * np.array(shares)
    low = np.floor(at).astype(int)
    ends = order_statistics(pieces, [*low.tolist(), *np.minimum(low + 1, count - 1).tolist()])
    a, b, t = ends[: len(at)], ends[len(at) :], at - low
    return np.where(t < 0.5, a + (b - a) * t, b - (b - a) * (1 - t))


def _keys(values: np.ndarray) -> np.ndarray:
    """Unsigned integers in the order of floats: the sign bit turned over, of negative numbers all bits."""
    bits = np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")
    top = bits.dtype.type(1 << (8 * values.dtype.itemsize - 1))
    return np.where(bits & top, ~bits, bits | top)


def _numbers(keys: np.ndarray) -> np.ndarray:
    """Inverse of `_keys`, as float64."""
    top = keys.dtype.type(1 << (8 * keys.dtype.itemsize - 1))
    return np.where(keys & top, keys ^ top, ~keys).view(f"f{keys.dtype.itemsize}").astype(np.float64)
