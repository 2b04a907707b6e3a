"""Sorting of elements by integer codes, with little memory apart from the codes and the result."""

import itertools

import numpy as np

from splatwire.ops._order_kernels import scatter, sort_buckets
from splatwire.ops.threads import parallel_map

SOME = 1 << 16
"""Maximum number of elements of a bucket that is sorted by comparisons."""
DIGIT_BITS = 16


def code_order(codes: np.ndarray, bits: int, groups: np.ndarray | None = None) -> np.ndarray:
    """Sorts elements by integer codes; elements with equal codes keep their order.

    Args:
        codes: Codes of at most 2**32 elements, non-negative int64 (N) below `1 << bits`.
        bits: Number of bits of a code.
        groups: Primary sort key of each element, 0 to 2**16 - 1, (N). Elements with equal primary keys are sorted by
            code. None to sort by the codes alone.

    Returns:
        Entry i is the index in `codes` of the i-th element in sorted order, uint32 (N).
    """
    order, all_elements = np.empty(len(codes), np.uint32), np.empty(0, np.uint32)
    if groups is None:
        _sort(codes, order, bits, all_elements)
        return order
    edges = _scatter(np.asarray(groups, np.int64), order, 0, all_elements)
    for begin, end in itertools.pairwise(np.unique(edges).tolist()):
        _sort(codes, order[begin:end], bits, order[begin:end].copy())
    return order


def _sort(codes: np.ndarray, order: np.ndarray, bits: int, indices: np.ndarray) -> None:
    """Sorts a subset of the elements by code, with a recursive radix sort.

    Args:
        codes: Codes of all elements, int64 (N).
        order: Output: the indices of the elements (in `codes`) in sorted order.
        bits: Number of low bits to sort by. The codes of the subset agree in all higher bits.
        indices: Indices of the elements to sort, uint32; empty for all elements.
    """
    shift = max(bits - DIGIT_BITS, 0)
    edges = _scatter(codes, order, shift, indices)
    if not shift:
        return
    parts = np.searchsorted(edges, np.arange(0, len(order) + SOME, SOME))
    parallel_map(
        lambda ends: sort_buckets(codes, order, edges[ends[0] : ends[1] + 1], SOME), list(itertools.pairwise(parts))
    )
    for digit in np.flatnonzero(np.diff(edges) > SOME).tolist():
        members = order[edges[digit] : edges[digit + 1]]
        _sort(codes, members, shift, members.copy())


def _scatter(codes: np.ndarray, order: np.ndarray, shift: int, indices: np.ndarray) -> np.ndarray:
    """Sorts elements by one digit (`DIGIT_BITS` bits) of their codes, stably; one pass of a radix sort.

    Args:
        codes: Codes of all elements, int64 (N).
        order: Output: the indices of the elements (in `codes`) in sorted order.
        shift: Number of bits below the digit.
        indices: Indices of the elements to sort, uint32; empty for all elements.

    Returns:
        Position in `order` of the first element with each digit, int64. The last entry is the number of elements.
    """
    edges = np.zeros((1 << DIGIT_BITS) + 1, np.int64)
    scatter(codes, indices, shift, np.empty(1 << DIGIT_BITS, np.int64), edges, order)
    return edges
