"""Numba kernels of the position coder, which codes a set of points as a binary tree.

The points are given as sorted Morton codes. A node of the tree is the range of points whose codes agree in the highest
bits. For each node, the kernels code how many of its points have a zero in the next bit.
"""
# Anchors on a coarse voxel grid have runs of zeros in their low bits, so contexts count the preceding zeros.
# Array slices are written element by element: numba compiles slice assignments with all shape checks and error
# messages, which takes longer than compiling the coder itself.

from typing import no_type_check

import numpy as np

from splatwire.entropy.normal_kernels import NORMAL, decode_symbol, encode_symbol
from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

MAX_BITS = 63
RUNS = 16
SMALL = 16
PAIR = MAX_BITS * RUNS
TREE = PAIR + 2 * MAX_BITS * RUNS
NUM_CONTEXTS = TREE + 3 * SMALL * SMALL


@njit(borrows=True)
@no_type_check
def large_count_normal(n):
    """Returns the normal distribution for coding the number of points in the first half of a large tree node.

    Args:
        n: Number of points of the node.

    Returns:
        Mean (n / 2) with 12 fractional bits; index of the standard deviation (about n / 4) in the coder's table.
    """
    exponent = 0
    while n >> (exponent + 1):
        exponent += 1
    return np.int64(n) << 11, min((exponent - 2 + 6) << 4, 319)


@njit(borrows=True, nogil=True)
@no_type_check
def split(codes, begin, end, bit):
    """Finds where a node of the position tree is divided: returns the index of the first code with a 1 in `bit`.

    In a node, all codes with a 0 in `bit` come before the codes with a 1. If no code of the node has a 1, the result is
    `end`.

    Args:
        codes: Sorted Morton codes.
        begin: Index of the node's first code.
        end: End of the node's codes (exclusive).
        bit: Index of the bit; the codes of a node agree in all higher bits.
    """
    low, high = begin, end
    while low < high:
        middle = (low + high) >> 1
        if (codes[middle] >> bit) & 1:
            high = middle
        else:
            low = middle + 1
    return low


@njit(borrows=True, nogil=True)
@no_type_check
def encode_count(buffer, state, models, n, zeros, bit, run, inverses, widths, table):
    """Encodes the number of points in the first half of a tree node.

    The first half contains the points with a 0 in `bit` of their Morton codes. In all higher bits, the Morton codes of
    a node's points agree (see `encode_codes`).

    Args:
        buffer: Output bytes.
        state: State of the range encoder.
        models: Adaptive bit models, changed in place.
        n: Number of points of the node.
        zeros: Number of points in the first half, 0 to `n`.
        bit: Index of the bit that divides the node.
        run: Number of consecutive 0 bits directly above `bit` in the node's codes, at most 15; selects the context.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
    """
    if n == 1:
        encode_bit(buffer, state, models, bit * RUNS + run, 1 - zeros)
    elif n == 2:
        base = PAIR + 2 * (bit * RUNS + run)
        parted = 1 if zeros == 1 else 0
        encode_bit(buffer, state, models, base, parted)
        if not parted:
            encode_bit(buffer, state, models, base + 1, 1 if zeros == 0 else 0)
    elif n < SMALL:
        node = 1
        base = TREE + ((bit % 3) * SMALL + n) * SMALL
        for shift in range(3, -1, -1):
            one = (zeros >> shift) & 1
            encode_bit(buffer, state, models, base + node, one)
            node = 2 * node + one
            if node >= SMALL:
                break
    else:
        mean, scale = large_count_normal(n)
        encode_symbol(buffer, state, zeros, mean, scale, ZERO, ZERO, NORMAL, inverses, widths, table)


@njit(borrows=True, nogil=True)
@no_type_check
def decode_count(data, end, state, models, n, bit, run, inverses, widths, table):
    """Decodes the number of points in the first half of a tree node, which `encode_count` has written.

    Args:
        data: Input bytes.
        end: End of the code in `data`.
        state: State of the range decoder.
        models: Adaptive bit models, changed in place.
        n: Number of points of the node.
        bit: Index of the bit that divides the node.
        run: Number of consecutive 0 bits directly above `bit` in the node's codes, at most 15; selects the context.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
    """
    if n == 1:
        return 1 - decode_bit(data, end, state, models, bit * RUNS + run)
    if n == 2:
        base = PAIR + 2 * (bit * RUNS + run)
        if decode_bit(data, end, state, models, base):
            return 1
        return 0 if decode_bit(data, end, state, models, base + 1) else 2
    if n < SMALL:
        node = 1
        base = TREE + ((bit % 3) * SMALL + n) * SMALL
        for _shift in range(4):
            node = 2 * node + decode_bit(data, end, state, models, base + node)
        return min(node - SMALL, n)
    mean, scale = large_count_normal(n)
    zeros = decode_symbol(data, end, state, mean, scale, ZERO, ZERO, NORMAL, inverses, widths, table)
    return min(max(zeros, 0), n)


@njit(nogil=True)
@no_type_check
def encode_codes(codes, bits, models, inverses, widths, table, buffer):
    """Encodes a set of points, given by their sorted Morton codes.

    The set is halved at each bit of the codes, from the highest bit. Each time, the number of points with a 0 in this
    bit is encoded: small numbers with adaptive bit models, large ones with a normal distribution.

    Args:
        codes: Morton codes, ascending, int64 (N).
        bits: Number of bits of a code.
        models: Adaptive bit models, changed in place.
        inverses: Reciprocal of each standard deviation in the coder's table of normal distributions.
        widths: For each standard deviation in this table, the largest distance from the mean that needs no escape code.
        table: Standard normal CDF, from `normal_table`.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    state = np.empty(3, np.int64)
    encoder_start(state)
    stack = np.empty((MAX_BITS + 2, 4), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, len(codes), bits - 1, 0
    top = 0
    while top >= 0:
        begin, end, bit, run = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        top -= 1
        if bit < 0 or begin == end:
            continue
        middle = split(codes, begin, end, bit)
        encode_count(buffer, state, models, end - begin, middle - begin, bit, run, inverses, widths, table)
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = middle, end, bit - 1, 0
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = begin, middle, bit - 1, min(run + 1, RUNS - 1)
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_codes(data, count, bits, models, inverses, widths, table, codes):
    """Decodes Morton codes written by `encode_codes`.

    Args:
        data: Input bytes.
        count: Number of codes.
        bits: Number of bits of a code.
        models: Adaptive bit models, changed in place.
        inverses: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest distance from the mean that needs no
            escape code.
        table: Standard normal CDF, from `normal_table`.
        codes: Output: the codes, ascending, int64 (`count`).
    """
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    stack = np.empty((MAX_BITS + 2, 5), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = 0, count, bits - 1, 0, 0
    top = 0
    while top >= 0:
        begin, end, bit, run = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        prefix = stack[top, 4]
        top -= 1
        if begin == end:
            continue
        if bit < 0:
            for i in range(begin, end):
                codes[i] = prefix
            continue
        zeros = decode_count(data, len(data), state, models, end - begin, bit, run, inverses, widths, table)
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = begin + zeros, end, bit - 1, 0
        stack[top, 4] = (prefix << 1) | 1
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2] = begin, begin + zeros, bit - 1
        stack[top, 3], stack[top, 4] = min(run + 1, RUNS - 1), prefix << 1
