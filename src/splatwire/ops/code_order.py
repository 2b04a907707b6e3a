"""Sorting of elements by integer codes that need not fit in memory."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

SOME = 1 << 16
"""Number of elements per batch."""
DIGIT_BITS = 16
Codes = Callable[[np.ndarray], np.ndarray]
"""Function from element indices to their codes, non-negative int64."""


def code_order(codes: Codes, count: int, bits: int, groups: np.ndarray | None = None) -> np.ndarray:
    """Sorts elements by integer codes; elements with equal codes keep their order.

    Args:
        codes: Function that returns the codes of the elements with given indices, below `1 << bits`. It is called
            several times for each element, to save memory.
        count: Number of elements N, at most 2**32.
        bits: Number of bits of a code.
        groups: Primary sort key of each element, 0 to 2**16 - 1, (N). Elements with equal primary keys are sorted by
            code. None to sort by the codes alone.

    Returns:
        Indices of the elements in sorted order, uint32 (N).
    """
    order = np.empty(count, np.uint32)
    if groups is None:
        _sort(codes, order, bits, range(count))
        return order
    edges = _scatter(lambda some: groups[some], order, range(count))
    for begin, end in itertools.pairwise(np.unique(edges).tolist()):
        _sort(codes, order[begin:end], bits, order[begin:end].copy())
    return order


def _sort(codes: Codes, order: np.ndarray, bits: int, indices: np.ndarray | range) -> None:
    """Sorts a subset of the elements by code: one level of a radix sort.

    Args:
        codes: Function that returns the codes of the elements with given indices.
        order: Output: the indices in sorted order.
        bits: Number of low bits to sort by; all higher bits of these elements are equal.
        indices: Indices of the elements to sort.
    """
    shift = max(bits - DIGIT_BITS, 0)
    edges = _scatter(lambda some: codes(some) >> shift & (1 << DIGIT_BITS) - 1, order, indices)
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


def _scatter(digits: Codes, order: np.ndarray, indices: np.ndarray | range) -> np.ndarray:
    """Sorts elements by one digit (`DIGIT_BITS` bits) of their codes, stably; one pass of a radix sort.

    Args:
        digits: Function that returns the digit of elements given by index.
        order: Output: the indices in sorted order.
        indices: Indices of the elements to sort.

    Returns:
        Position in `order` of the first element with each digit, and the number of elements, int64.
    """
    edges = np.zeros((1 << DIGIT_BITS) + 1, np.int64)
    for some in _pieces(indices):
        edges[1:] += np.bincount(digits(some), minlength=1 << DIGIT_BITS)
    np.cumsum(edges, out=edges)
    free = edges[:-1].copy()
    for some in _pieces(indices):
        # numpy sorts 16-bit integers with a radix sort.
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
