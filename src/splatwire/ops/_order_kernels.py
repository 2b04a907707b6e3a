"""Numba kernels that sort and select numbers digit by digit (`order_statistics`, `code_order`)."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit
from splatwire.ops.prefetch import prefetch

AHEAD = 8
"""Distance between the element that is sorted and the element whose code is prefetched, in elements."""
INSERTED = 48
"""Maximum number of elements that are sorted by insertion."""


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def count_digits(values, prefixes, shift, bits, counts):
    """Counts how often each value of a digit occurs in the sort keys of floating-point numbers (radix selection).

    A sort key is an unsigned integer. For a positive number, it consists of the bits of the number with the sign bit
    inverted. For a negative number, all bits are inverted. Keys therefore have the same order as the numbers. A digit
    is a group of consecutive bits of the key.

    Args:
        values: Bits of the numbers, not yet converted to keys: float32 or float64 viewed as uint32 or uint64 (n).
        prefixes: Possible values of the bits above the digit, ascending, in the type of `values` (P). Keys with other
            upper bits are not counted.
        shift: Number of bits below the digit.
        bits: Number of bits of the digit.
        counts: Number of keys with each prefix and digit, int64 (P, `1 << bits`); increased in place.
    """
    top = 8 * values.itemsize - 1
    mask = (1 << bits) - 1
    for value in values:
        number = np.int64(value)
        # Arithmetic on int64: all bits of a negative number are inverted by the sign, without a branch.
        sign = (number >> top) & 1
        key = number ^ (-sign if top == 63 else (-sign) & 0xFFFFFFFF) ^ ((1 - sign) << top)
        digit = (key >> shift) & mask
        upper = ((key >> shift) >> bits) & ((np.int64(1) << (top + 1 - shift - bits)) - 1)
        for p in range(len(prefixes)):
            if np.int64(prefixes[p]) == upper:
                counts[p, digit] += 1


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def scatter(codes, indices, shift, free, edges, order):
    """Sorts elements by one digit of their codes, stably; one pass of a radix sort.

    Args:
        codes: Codes of all elements, int64 (N).
        indices: Indices of the elements to sort, uint32; empty to sort all elements in their input order.
        shift: Number of bits below the digit.
        free: Working array, int64 (digits); the number of digits is a power of two.
        edges: Output: position in `order` of the first element with each digit, int64 (digits + 1). The last entry is
            the number of elements. All entries must be 0 before the call.
        order: Output: the indices of the elements (in `codes`) in sorted order, uint32.
    """
    mask, listed = len(free) - 1, len(indices) > 0
    for i in range(len(order)):
        index = np.int64(indices[i]) if listed else i
        edges[((codes[index] >> shift) & mask) + 1] += 1
    for digit in range(len(free)):
        free[digit] = edges[digit]
        edges[digit + 1] += edges[digit]
    for i in range(len(order)):
        index = np.int64(indices[i]) if listed else i
        digit = (codes[index] >> shift) & mask
        order[free[digit]] = index
        free[digit] += 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def sort_buckets(codes, order, edges, most):
    """Sorts the elements of each bucket by their codes, stably.

    Args:
        codes: Codes of all elements, int64 (N).
        order: Indices of the elements, uint32, bucket after bucket; each bucket is sorted in place.
        edges: Position in `order` of the first element of each bucket, int64 (buckets + 1). The last entry is the
            number of elements.
        most: Maximum number of elements of a bucket; larger buckets are not changed.
    """
    keys, indices = np.empty(INSERTED, np.int64), np.empty(INSERTED, np.uint32)
    for bucket in range(len(edges) - 1):
        begin, end = edges[bucket], edges[bucket + 1]
        if end - begin < 2 or end - begin > most:
            continue
        if end - begin > INSERTED:
            bucket_order = order[begin:end].copy()
            order[begin:end] = bucket_order[np.argsort(codes[bucket_order], kind="mergesort")]
            continue
        for count in range(end - begin):
            prefetch(codes, np.int64(order[min(begin + count + AHEAD, len(order) - 1)]), np.int64(0))
            index = order[begin + count]
            key, at = codes[index], count
            while at > 0 and keys[at - 1] > key:
                keys[at], indices[at] = keys[at - 1], indices[at - 1]
                at -= 1
            keys[at], indices[at] = key, index
        for i in range(end - begin):
            order[begin + i] = indices[i]
