"""Numba kernels that encode or decode the coarse positions of a packet's Gaussians: sorted Morton codes of grid cells.

The codes form a binary tree. A node is a range of sorted codes that agree in all higher bits.
"""

from typing import no_type_check

from splatwire.codec._coder_kernels import code_below, code_bit, code_raw
from splatwire.codec._geometry_kernels import split
from splatwire.entropy.range_kernels import ONE, ZERO
from splatwire.ops.compiled import njit

NUM_UNSPLIT = 4
"""Number of contexts by the number of levels without a split: 0, 1, 2, and 3 or more."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_cells(coder, codes, bits, stack):
    """Encodes or decodes the sorted Morton codes of a packet's grid cells, as a binary tree.

    Args:
        coder: Entropy coder.
        codes: The codes in ascending order, int64 (n): input of an encoder, output of a decoder.
        bits: Number of bits of a code.
        stack: Working array, int64 (at least `bits` + 2, 5).
    """
    _push(stack, 0, 0, len(codes), bits - 1, 0, 0)
    top = 0
    while top >= 0:
        begin, end, bit = stack[top, 0], stack[top, 1], stack[top, 2]
        unsplit_levels, prefix = stack[top, 3], stack[top, 4]
        top -= 1
        if begin == end:
            continue
        if bit < 0 or end - begin == 1:
            low = codes[begin] & ((1 << (bit + 1)) - 1)
            low = code_raw(coder, low, bit + 1) if bit >= 0 else 0
            for i in range(begin, end):
                codes[i] = (prefix << (bit + 1)) | low
            continue
        zeros = split(codes, begin, end, bit) - begin if not coder.decoding else 0
        zeros = _code_zeros(coder, end - begin, zeros, unsplit_levels)
        unsplit_levels = min(unsplit_levels + 1, NUM_UNSPLIT - 1) if zeros == 0 or zeros == end - begin else 0
        _push(stack, top + 1, begin + zeros, end, bit - 1, unsplit_levels, (prefix << 1) | 1)
        _push(stack, top + 2, begin, begin + zeros, bit - 1, unsplit_levels, prefix << 1)
        top += 2


@njit(borrows=True, error_model="numpy")
@no_type_check
def _push(stack, top, begin, end, bit, unsplit_levels, prefix):
    """Pushes a node of the binary tree of Morton codes onto the stack of nodes to code.

    Args:
        stack: Stack of nodes, int64 (nodes, 5).
        top: Row of `stack` to write.
        begin: Index of the node's first code.
        end: End of the node's codes (exclusive).
        bit: Bit at which the node is divided.
        unsplit_levels: Number of divisions without effect directly above the node. A division has no effect if all
            codes of the divided node have the same bit. The number selects the context of the entropy coder, and is
            clipped to `NUM_UNSPLIT - 1`.
        prefix: Bits above `bit`, which all codes of the node share.
    """
    # Numbers are assigned separately, because numba takes seconds to compile the assignment of a tuple.
    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4] = begin, end, bit, unsplit_levels, prefix


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_zeros(coder, n, zeros, unsplit_levels):
    size_class = 0
    while n >> (size_class + 1) and size_class < 8:
        size_class += 1
    is_unsplit = 1 if zeros == 0 or zeros == n else 0
    if code_bit(coder, (size_class - 1) * NUM_UNSPLIT + unsplit_levels, is_unsplit):
        return n if code_raw(coder, ONE if zeros == n else ZERO, ONE) else 0
    return 1 + code_below(coder, zeros - 1, n - 1)
