"""Numba kernels that code the motion of a packet's tracks in either direction, given nothing but its bytes."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import code_below, code_bit, code_escape, code_flag, code_raw
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
from splatwire.entropy.range_kernels import ONE
from splatwire.ops.compiled import njit

_code_bit = njit(borrows=True, error_model="numpy", forceinline=True)(code_bit.py_func)
"""`code_bit` in place, for a coefficient's: a call would pass all of the coder, which takes two thirds of the time."""


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
def _code_coefficient(coder, kind, order, level, value):
    """Codes one residual: whether it is 0, its octave, the rest of its bits, its sign."""
    zero = C_ZERO + (kind * ORDERS + min(order, ORDERS - 1)) * LEVELS + level
    if not _code_bit(coder, np.int64(zero), 1 if value else 0):
        return np.int64(0)
    magnitude, octave = abs(value), np.int64(0)
    base = C_OCTAVE + (kind * LEVELS + level) * MAGNITUDES
    while octave < MAX_OCTAVE:
        if not _code_bit(coder, np.int64(base + min(octave, MAGNITUDES - 1)), 1 if magnitude >> (octave + 1) else 0):
            break
        octave += 1
    rest = code_raw(coder, magnitude - (ONE << octave), octave)
    magnitude = min((ONE << octave) + rest, MAX_QUANTISED)
    return -magnitude if code_flag(coder, 1 if value < 0 else 0) else magnitude


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
    before = -1
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
                value = _code_coefficient(coder, kind, k, _level(near), np.int64(quantised[i, c, k]))
                quantised[i, c, k] = value
                own = abs(value) if k == 0 and first else max(own, abs(value))
            largest = max(largest, own)
        before = i
