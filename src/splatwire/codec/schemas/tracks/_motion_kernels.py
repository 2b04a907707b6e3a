"""Numba kernels that code the motion of a packet's tracks in either direction, given nothing but its bytes."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import code_below, code_bit, code_escape, code_raw
from splatwire.codec.schemas.tracks.layout import (
    AFTER,
    BEFORE,
    BEGINS,
    C_BEGINS,
    C_ENDS,
    C_GONE,
    C_MOVING,
    C_OCTAVE,
    C_ZERO,
    CANDIDATE_BITS,
    ENDS,
    KIND_OF,
    LEVELS,
    MAGNITUDES,
    MAX_CANDIDATES,
    MAX_OCTAVE,
    MAX_QUANTISED,
    MOVING,
    NUM_CHANNELS,
    NUM_KINDS,
    ORDERS,
    STATE,
    TRACK,
    TRACK_BITS,
)
from splatwire.entropy.range_kernels import (
    ADAPTIVE_BITS,
    BOTTOM,
    LOW_MASK,
    ONE,
    RAW_BITS,
    TOP,
    ZERO,
    adaptive_size,
    adaptive_update,
)
from splatwire.ops.compiled import njit


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_heads(coder, heads, n, frames, first_new):
    """Codes which tracks these are, and when each of them is there; returns how many rows were found, at most n."""
    first = code_raw(coder, heads[0, TRACK], TRACK_BITS)
    lead = code_escape(coder, heads[0, BEFORE])
    count = code_raw(coder, heads[n - 1, TRACK] + 1 - first, CANDIDATE_BITS)
    tail = code_escape(coder, heads[n - 1, AFTER])
    at, gone_before, moved, before = 0, 0, 0, first - lead
    for track in range(first, first + min(count, MAX_CANDIDATES)):
        here = not coder.decoding and heads[at, TRACK] == track
        gone_before = code_bit(coder, C_GONE + gone_before, 0 if here else 1)
        if gone_before:
            continue
        if at == n:
            break
        state = code_bit(coder, C_MOVING + moved, heads[at, STATE])
        moved = ((moved << 1) | state) & 3
        begins, ends = np.int64(0), frames
        if track >= first_new and code_bit(coder, np.int64(C_BEGINS), 1 if heads[at, BEGINS] else 0):
            begins = code_below(coder, heads[at, BEGINS], frames)
        if code_bit(coder, np.int64(C_ENDS), 1 if heads[at, ENDS] < frames else 0):
            ends = code_below(coder, heads[at, ENDS], frames)
        heads[at, TRACK], heads[at, STATE], heads[at, BEGINS], heads[at, ENDS] = track, state, begins, ends
        heads[at, BEFORE], heads[at, AFTER] = track - before, 0
        before = track + 1
        at += 1
    if at:
        heads[at - 1, AFTER] = tail
    return at


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _level(magnitude):
    """Context of a coefficient: the octave of what is near to it."""
    level = 0
    while magnitude >> level and level < LEVELS - 1:
        level += 1
    return level


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _narrowed(coder, low, span, at, start, size, bits):
    """What `encode_interval` and `decode_advance` do, to a state that stays in registers over all coefficients."""
    unit = span >> bits
    span = unit * size
    if coder.decoding:
        low = min(low - unit * start, span - 1)
        while span < BOTTOM:
            low <<= 8
            if at < coder.end:
                low |= np.int64(coder.data[at])
            at += 1
            span <<= 8
        return low, span, at
    low += unit * start
    if low >> TOP:
        low &= (ONE << TOP) - 1
        back = at - 1
        while coder.data[back] == 255:
            coder.data[back] = 0
            back -= 1
        coder.data[back] += 1
    while span < BOTTOM:
        coder.data[at] = low >> 40
        at += 1
        low = (low & LOW_MASK) << 8
        span <<= 8
    return low, span, at


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _bit(coder, low, span, at, context, bit):
    """As `code_bit`; returns the state, too."""
    zero = adaptive_size(coder.models, context)
    if coder.decoding:
        bit = ONE if low >= zero * (span >> ADAPTIVE_BITS) else ZERO
    else:
        coder.bits[context, bit] += 1
    adaptive_update(coder.models, context, bit)
    if bit:
        low, span, at = _narrowed(coder, low, span, at, zero, 65536 - zero, ADAPTIVE_BITS)
    else:
        low, span, at = _narrowed(coder, low, span, at, ZERO, zero, ADAPTIVE_BITS)
    return bit, low, span, at


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _raw(coder, low, span, at, value, bits):
    """As `code_raw`; returns the state, too."""
    found = ZERO
    while bits > 0:
        some = min(bits, RAW_BITS)
        bits -= some
        part = (value >> bits) & ((ONE << some) - 1)
        if coder.decoding:
            part = min(low // (span >> some), (ONE << some) - 1)
        low, span, at = _narrowed(coder, low, span, at, part, ONE, some)
        found = (found << some) | part
    return found, low, span, at


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_coefficient(coder, low, span, at, kind, order, level, value):
    """Codes one residual: whether it is 0, its octave, the rest of its bits, its sign; returns the state, too."""
    zero = C_ZERO + (kind * ORDERS + min(order, ORDERS - 1)) * LEVELS + level
    some, low, span, at = _bit(coder, low, span, at, np.int64(zero), ONE if value else ZERO)
    if not some:
        return ZERO, low, span, at
    magnitude, octave = abs(value), ZERO
    base = C_OCTAVE + (kind * LEVELS + level) * MAGNITUDES
    while octave < MAX_OCTAVE:
        context, above = np.int64(base + min(octave, MAGNITUDES - 1)), ONE if magnitude >> (octave + 1) else ZERO
        above, low, span, at = _bit(coder, low, span, at, context, above)
        if not above:
            break
        octave += 1
    rest, low, span, at = _raw(coder, low, span, at, magnitude - (ONE << octave), octave)
    magnitude = min((ONE << octave) + rest, MAX_QUANTISED)
    negative = ONE if value < 0 else ZERO
    if coder.decoding:
        negative = ONE if low >= span >> ONE else ZERO
    low, span, at = _narrowed(coder, low, span, at, negative, ONE, ONE)
    return -magnitude if negative else magnitude, low, span, at


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_motion(coder, heads, n, orders, quantised, frames, first_new):
    """Codes a packet.

    `heads`, int64 (n, HEAD), ascending by track; `orders`, int64 (kinds); `quantised`, int32 (n, C, F); a decoder's are
    filled, zero before. Of bytes that no encoder wrote, rows that were not found stay gone: their track is -1.
    """
    if coder.decoding:
        heads[:] = -1
    found = _code_heads(coder, heads, n, frames, first_new)
    for kind in range(NUM_KINDS):
        orders[kind] = code_below(coder, orders[kind], frames + 1)
    before, low, span, place = -1, coder.state[0], coder.state[1], coder.state[2]
    for i in range(found):
        if heads[i, STATE] != MOVING:
            continue
        largest = np.int64(0)
        for c in range(NUM_CHANNELS):
            kind, own = KIND_OF[c], np.int64(0)
            first = c == 0 or KIND_OF[c - 1] != kind
            if first:
                largest = np.int64(0)
                if before >= 0:
                    own = abs(np.int64(quantised[before, c, 0]))
            for k in range(orders[kind]):
                near = max(own, largest)
                if not first:
                    near = max(near, 2 * abs(np.int64(quantised[i, c - 1, k])))
                value = np.int64(quantised[i, c, k])
                value, low, span, place = _code_coefficient(coder, low, span, place, kind, k, _level(near), value)
                quantised[i, c, k] = value
                own = abs(value) if k == 0 and first else max(own, abs(value))
            largest = max(largest, own)
        before = i
    coder.state[0], coder.state[1], coder.state[2] = low, span, place
