"""Numba kernels that code the positions of anchors: the high bits in the side information, the low bits in the packets.

Positions are sorted Morton codes.
"""
# The high bits form a binary tree, whose leaves contain at most `max_leaf` codes each. The low bits of a code are
# divided into triples (one bit per axis). First, the index and the value of the lowest triple that is not 0 are coded;
# this suits anchors on grids of several widths. The bits above are coded without a model.

from typing import no_type_check

import numpy as np

from splatwire.codec._geometry_kernels import split
from splatwire.entropy.range_kernels import (
    ONE,
    RAW_BITS,
    ZERO,
    decode_advance,
    decode_below,
    decode_bit,
    decode_bits,
    decode_raw,
    decode_target,
    decoder_start,
    encode_below,
    encode_bit,
    encode_bits,
    encode_interval,
    encode_raw,
    encoder_finish,
    encoder_start,
)
from splatwire.ops.compiled import njit

PROBABILITY_BITS = np.int64(8)
MAX_STACK = 65
"""Maximum number of nodes on the stack: one per bit of a Morton code, and two more."""
NUM_UNSPLIT = 4
"""Number of contexts by the number of levels without a split: 0, 1, 2, and 3 or more."""
NUM_SIZE_CLASSES = 8
"""Number of contexts for the size of a node. The size is log2 of the number of anchors: 1 to 7, or at least 8."""
NUM_CONTEXTS = NUM_SIZE_CLASSES * NUM_UNSPLIT


@njit(borrows=True, error_model="numpy")
@no_type_check
def _context(n, unsplit_levels):
    """Returns the context of the bit that is set if all anchors of a tree node lie in one half of the node.

    Args:
        n: Number of anchors of the node, at least 2.
        unsplit_levels: Number of levels directly above with all anchors in one half, 0 to `NUM_UNSPLIT - 1`.
    """
    size_class = 0
    while n >> (size_class + 1) and size_class < NUM_SIZE_CLASSES:
        size_class += 1
    return (size_class - 1) * NUM_UNSPLIT + unsplit_levels


@njit(borrows=True, error_model="numpy")
@no_type_check
def _num_raw_bits(count):
    """Returns the number of low bits of a coded integer that are coded with equal probabilities of 0 and 1.

    The integer is from 0 to `count - 1`. Its high bits, at most 16, are coded with equal probabilities of all values
    that they can have.
    """
    # `encode_below` supports at most 2**16 values, so a larger number is split.
    shift = 0
    while ((count - 1) >> shift) >> RAW_BITS:
        shift += 1
    return shift


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_tree(codes, bits, max_leaf, models, buffer):
    """Encodes the high bits of all anchors' positions as a binary tree.

    Args:
        codes: Morton codes, ascending, int64 (N).
        bits: Number of bits of a Morton code.
        max_leaf: Maximum number of anchors in a leaf; nodes with more are divided.
        models: Adaptive bit models, changed in place.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    state, stack, top = np.empty(3, np.int64), np.empty((MAX_STACK, 4), np.int64), 0
    encoder_start(state)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, len(codes), bits - 1, 0
    while top >= 0:
        begin, end, bit, unsplit_levels = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        n = end - begin
        top -= 1
        if bit < 0 or n <= max_leaf:
            continue
        middle = split(codes, begin, end, bit)
        is_unsplit = np.int64(1 if middle in (begin, end) else 0)
        encode_bit(buffer, state, models, _context(n, unsplit_levels), is_unsplit)
        if is_unsplit:
            encode_raw(buffer, state, np.int64(1 if middle == end else 0))
        else:
            number, shift = middle - begin - 1, _num_raw_bits(n - 1)
            encode_below(buffer, state, number >> shift, ((n - 2) >> shift) + 1)
            if shift:
                encode_interval(buffer, state, number & ((ONE << shift) - 1), ONE, shift)
        unsplit_levels = min(unsplit_levels + 1, NUM_UNSPLIT - 1) if is_unsplit else 0
        top += 2
        stack[top - 1, 0], stack[top - 1, 1], stack[top - 1, 2] = middle, end, bit - 1
        stack[top, 0], stack[top, 1], stack[top, 2] = begin, middle, bit - 1
        stack[top - 1, 3] = stack[top, 3] = unsplit_levels
    return encoder_finish(buffer, state)


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_tree(data, bits, max_leaf, models, codes, num_low_bits):
    """Decodes the high bits of positions from the tree written by `encode_tree`, and estimates the low bits.

    Args:
        data: Bytes of the tree.
        bits: Number of bits of a Morton code.
        max_leaf: Maximum number of anchors in a leaf.
        models: Adaptive bit models, changed in place.
        codes: Output: Morton codes, ascending, int64 (N).
        num_low_bits: Output: number of low bits of each Morton code that are only estimated, int64 (N).
    """
    state, stack, top = np.empty(3, np.int64), np.empty((MAX_STACK, 5), np.int64), 0
    decoder_start(data, ZERO, len(data), state)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = 0, len(codes), bits - 1, 0, 0
    while top >= 0:
        begin, end, bit, unsplit_levels = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        n, prefix = end - begin, stack[top, 4]
        top -= 1
        if bit < 0 or n <= max_leaf:
            for i in range(begin, end):
                codes[i] = (prefix << (bit + 1)) | _estimate_low_bits(i - begin, n, bit + 1)
                num_low_bits[i] = bit + 1
            continue
        is_unsplit = decode_bit(data, len(data), state, models, _context(n, unsplit_levels))
        if is_unsplit:
            zeros = n if decode_raw(data, len(data), state) else 0
        else:
            shift = _num_raw_bits(n - 1)
            number = decode_below(data, len(data), state, ((n - 2) >> shift) + 1)
            if shift:
                low = decode_target(state, shift)
                decode_advance(data, len(data), state, low, ONE, shift)
                number = (number << shift) | low
            zeros = 1 + min(number, n - 2)
        unsplit_levels = min(unsplit_levels + 1, NUM_UNSPLIT - 1) if is_unsplit else 0
        top += 2
        stack[top - 1, 0], stack[top - 1, 1], stack[top - 1, 2] = begin + zeros, end, bit - 1
        stack[top - 1, 3], stack[top - 1, 4] = unsplit_levels, (prefix << 1) | 1
        stack[top, 0], stack[top, 1], stack[top, 2] = begin, begin + zeros, bit - 1
        stack[top, 3], stack[top, 4] = unsplit_levels, prefix << 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def _estimate_low_bits(i, n, bits):
    """Estimates the low bits of an anchor's Morton code, for use if the packet that contains them is lost.

    The anchors of a leaf of the position tree are assumed to be evenly spaced.

    Args:
        i: Index of the anchor within its leaf, in Morton order.
        n: Number of anchors in the leaf.
        bits: Number of low bits to estimate.
    """
    depth = 0
    while (n - 1) >> depth:
        depth += 1
    value, shift = (((np.int64(i) << depth) // n) << 3) | 7, bits - depth - 3
    return value << shift if shift >= 0 else value >> -shift


@njit(borrows=True, error_model="numpy")
@no_type_check
def encode_position(out, state, code, num_low_bits, low_bit_probabilities):
    """Encodes the low bits of an anchor's position; the side information contains only the high bits.

    Args:
        out: Output bytes of the range encoder.
        state: State of the range encoder, changed in place.
        code: Morton code of the anchor's position.
        num_low_bits: Number of low bits to encode.
        low_bit_probabilities: Probabilities for coding the low bits, see `CoarsePositions.low_bit_probabilities`.
    """
    low_bits, num_triples = code & ((ONE << num_low_bits) - 1), (num_low_bits + 2) // 3
    triple = np.int64(0)
    while triple < num_triples and not (low_bits >> (3 * triple)) & 7:
        stop_probability = low_bit_probabilities[num_triples, triple]
        continue_probability = (ONE << PROBABILITY_BITS) - stop_probability
        encode_interval(out, state, stop_probability, continue_probability, PROBABILITY_BITS)
        triple += 1
    if triple == num_triples:
        return
    encode_interval(out, state, ZERO, low_bit_probabilities[num_triples, triple], PROBABILITY_BITS)
    num_remaining = num_low_bits - 3 * triple
    triple_bits = min(num_remaining, 3)
    encode_bits(out, state, low_bits >> (3 * triple + triple_bits), num_remaining - triple_bits)
    if triple_bits > 1:
        max_value = (ONE << triple_bits) - 1
        encode_below(out, state, ((low_bits >> (3 * triple)) & max_value) - 1, max_value)


@njit(borrows=True, error_model="numpy")
@no_type_check
def decode_position(data, end, state, code, num_low_bits, low_bit_probabilities):
    """Decodes the low bits of an anchor's position, and returns the complete Morton code.

    Args:
        data: Input bytes of the range decoder.
        end: End of the packet in `data`.
        state: State of the range decoder, changed in place.
        code: Morton code with estimated low bits, which are replaced.
        num_low_bits: Number of low bits to decode.
        low_bit_probabilities: Probabilities for coding the low bits, see `CoarsePositions.low_bit_probabilities`.
    """
    num_triples, triple = (num_low_bits + 2) // 3, np.int64(0)
    while triple < num_triples:
        stop_probability = low_bit_probabilities[num_triples, triple]
        if decode_target(state, PROBABILITY_BITS) < stop_probability:
            decode_advance(data, end, state, ZERO, stop_probability, PROBABILITY_BITS)
            break
        continue_probability = (ONE << PROBABILITY_BITS) - stop_probability
        decode_advance(data, end, state, stop_probability, continue_probability, PROBABILITY_BITS)
        triple += 1
    high_bits = (code >> num_low_bits) << num_low_bits
    if triple == num_triples:
        return high_bits
    num_remaining = num_low_bits - 3 * triple
    triple_bits = min(num_remaining, 3)
    upper_bits = decode_bits(data, end, state, num_remaining - triple_bits)
    value = decode_below(data, end, state, (ONE << triple_bits) - 1) if triple_bits > 1 else ZERO
    return high_bits | (((upper_bits << triple_bits) | (value + 1)) << (3 * triple))


@njit(borrows=True, error_model="numpy")
@no_type_check
def position_bits(code, num_low_bits, low_bit_probabilities):
    """Returns the number of bits of an anchor's position in a packet, float64.

    Args:
        code: Morton code of the anchor's position.
        num_low_bits: Number of low bits of the Morton code that the packet contains.
        low_bit_probabilities: Probabilities for coding the low bits, see `CoarsePositions.low_bit_probabilities`.
    """
    low_bits, num_triples, total = code & ((ONE << num_low_bits) - 1), (num_low_bits + 2) // 3, 0.0
    for triple in range(num_triples):
        stop_probability = low_bit_probabilities[num_triples, triple]
        if (low_bits >> (3 * triple)) & 7:
            num_remaining = num_low_bits - 3 * triple
            triple_bits = min(num_remaining, 3)
            total += 8.0 - np.log2(float(stop_probability)) + num_remaining - triple_bits
            return total + np.log2(float((1 << triple_bits) - 1))
        total += 8.0 - np.log2(256.0 - stop_probability)
    return total


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def decode_positions(data, byte_starts, anchor_starts, states, codes, num_low_bits, low_bit_probabilities):
    """Decodes the low bits of the positions of all packets' anchors.

    Args:
        data: Bytes of all packets.
        byte_starts: Packet p has the bytes from `byte_starts[p]` to `byte_starts[p + 1]` (exclusive) of `data`.
        anchor_starts: Packet p has the anchors from `anchor_starts[p]` to `anchor_starts[p + 1]` (exclusive).
        states: State of the range decoder of each packet, changed in place.
        codes: Morton codes of all anchors; estimated low bits are replaced by the decoded bits.
        num_low_bits: Number of low bits to decode for each anchor.
        low_bit_probabilities: Probabilities for coding the low bits, see `CoarsePositions.low_bit_probabilities`.
    """
    for p in range(states.shape[0]):
        for n in range(anchor_starts[p], anchor_starts[p + 1]):
            codes[n] = decode_position(
                data, byte_starts[p + 1], states[p], codes[n], num_low_bits[n], low_bit_probabilities
            )
