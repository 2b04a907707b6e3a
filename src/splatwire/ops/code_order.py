"""Sorting by codes that are computed when they are needed: beside the order itself, memory is that of some elements."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

SOME = 1 << 16
"""Elements that are looked at at a time."""
DIGIT_BITS = 16
Codes = Callable[[np.ndarray], np.ndarray]
"""Codes of the elements of some indices, int64, not negative."""


def code_order(codes: Codes, count: int, bits: int, groups: np.ndarray | None = None) -> np.ndarray:
    """Stable order of elements by their codes: by the highest digit into buckets, and each few buckets on their own.

    Args:
        codes: Gives codes below `1 << bits`, the same ones whenever it is asked.
        count: Elements, N, at most 2**32.
        bits: See `codes`.
        groups: Integers from 0 below 2**16 that elements are sorted by first, N; None for one group.

    Returns:
        Indices, uint32, N.
    """
    order = np.empty(count, np.uint32)
    if groups is None:
        _sort(codes, order, bits, range(count))
        return order
    edges = _scatter(lambda some: groups[some], order, range(count))
    for begin, end in itertools.pairwise(np.unique(edges).tolist()):
        _sort(codes, order[begin:end], bits, order[begin:end].copy())
    return order


def _sort(codes: Codes, order: np.ndarray, bits: int, members: np.ndarray | range) -> None:
    """Writes `members`, whose codes agree in all but their lowest `bits` bits, into `order`, sorted."""
    shift = max(bits - DIGIT_BITS, 0)
    edges = _scatter(lambda some: codes(some) >> shift & (1 << DIGIT_BITS) - 1, order, members)
    if not shift:
        return
    begin, total = 0, len(order)
    while begin < total:
        end = int(edges[np.searchsorted(edges, begin + SOME, side="right") - 1])
        if end > begin:
            here = order[begin:end]
            here[:] = here[np.argsort(codes(here), kind="stable")]
        else:
            end = int(edges[np.searchsorted(edges, begin, side="right")])
            _sort(codes, order[begin:end], shift, order[begin:end].copy())
        begin = end


def _scatter(digits: Codes, order: np.ndarray, members: np.ndarray | range) -> np.ndarray:
    """Writes members into `order` by rising digit, else in the order in which they come.

    Returns:
        Where the members of each digit begin, and the end, int64, `(1 << DIGIT_BITS) + 1`.
    """
    edges = np.zeros((1 << DIGIT_BITS) + 1, np.int64)
    for some in _pieces(members):
        edges[1:] += np.bincount(digits(some), minlength=1 << DIGIT_BITS)
    np.cumsum(edges, out=edges)
    free = edges[:-1].copy()
    for some in _pieces(members):
        # Sorting 16 bits is the radix sort of numpy.
        found = digits(some).astype(np.uint16)
        by = np.argsort(found, kind="stable")
        found = found[by]
        first = np.flatnonzero(np.diff(found, prepend=-1))
        sizes = np.diff(first, append=len(found))
        order[np.arange(len(found)) + np.repeat(free[found[first]] - first, sizes)] = some[by]
        free[found[first]] += sizes
    return edges


def _pieces(members: np.ndarray | range) -> Iterator[np.ndarray]:
    for begin in range(0, len(members), SOME):
        some = members[begin : begin + SOME]
        yield np.arange(some.start, some.stop, dtype=np.uint32) if isinstance(some, range) else some
