"""Numba kernels that code whole packets of motion, and cut them by their size."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import DECODING, ENCODING, new_coder
from splatwire.codec.schemas.tracks._motion_kernels import code_motion
from splatwire.codec.schemas.tracks._predict_kernels import follow_neighbours, take
from splatwire.codec.schemas.tracks.layout import (
    KIND_OF,
    MAX_CANDIDATES,
    MOVING,
    NUM_CHANNELS,
    NUM_CONTEXTS,
    NUM_KINDS,
    STATE,
    TRACK,
)
from splatwire.entropy.range_kernels import ZERO, decoder_start, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

AIM, ENOUGH = 5, 3
"""As `splatwire.codec.schemas.gaussians._packet_kernels` cuts."""
SLACK, TRACK_BYTES = 64, 4
"""Bytes of a packet's buffer beside its coefficients, and for the head of each track."""


@njit(error_model="numpy")
@no_type_check
def _tables():
    """What a coder takes of residuals' tables, which motion has none of."""
    one = np.zeros(1, np.int64)
    return np.zeros((1, 1, 1), np.int64), one, one, one


@njit(error_model="numpy")
@no_type_check
def _needed_orders(targets, rows, states, shifts, frames, orders):
    """How many coefficients of each kind are worth coding: behind them no target of what moves is half a step."""
    orders[:] = 0
    for i in range(len(rows)):
        if states[i] != MOVING:
            continue
        for c in range(NUM_CHANNELS):
            kind = KIND_OF[c]
            for k in range(frames - 1, orders[kind] - 1, -1):
                if 2 * abs(targets[rows[i], c, k]) >= np.float64(np.int64(1) << shifts[i, c]):
                    orders[kind] = k + 1
                    break


@njit(error_model="numpy")
@no_type_check
def _trim(quantised, orders):
    """Leaves out orders behind which every residual is 0."""
    for kind in range(NUM_KINDS):
        while orders[kind]:
            some = False
            for i in range(len(quantised)):
                for c in range(NUM_CHANNELS):
                    some |= KIND_OF[c] == kind and quantised[i, c, orders[kind] - 1] != 0
            if some:
                break
            orders[kind] -= 1


@njit(error_model="numpy")
@no_type_check
def _encode_packet(models, counts, frames, first_new, dead, heads, places, shifts, targets, rows, buffer, out):
    """Encodes one packet; returns its length. `out` takes the residuals, int32 (n, C, F)."""
    n, used = len(heads), 0
    orders, states = np.zeros(NUM_KINDS, np.int64), heads[:, STATE].copy()
    _needed_orders(targets, rows, states, shifts, frames, orders)
    for c in range(NUM_CHANNELS):
        used += orders[KIND_OF[c]]
    wanted = np.empty((n, used))
    take(targets, rows, states, orders, wanted)
    out[:] = 0
    follow_neighbours(places, states, shifts, orders, out, wanted, dead, np.zeros((0, 1, 1), np.float32))
    _trim(out, orders)
    coder = new_coder(
        ENCODING, buffer, ZERO, models.copy(), (counts, np.zeros((1, 1, 1, 2), np.int64)), _tables()
    )  # fmt: skip
    encoder_start(coder.state)
    code_motion(coder, heads.copy(), n, orders, out, frames, first_new)
    return encoder_finish(buffer, coder.state)


@njit(error_model="numpy")
@no_type_check
def _candidates(heads, begin, n):
    """How many of the n rows from `begin` are within the tracks that a packet may speak of."""
    while n > 1 and heads[begin + n - 1, TRACK] - heads[begin, TRACK] >= MAX_CANDIDATES:
        n -= 1
    return n


@njit(error_model="numpy")
@no_type_check
def _expected(costs, begin, end, scale, aim):
    """How many rows from `begin` are expected to take `aim` bytes, at least one."""
    total, at = 0.0, begin
    while at < end and (at == begin or (total + costs[at]) * scale <= aim):
        total += costs[at]
        at += 1
    return at - begin


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_cut(
    models, counts, frames, first_new, dead, heads, places, shifts, targets, rows, most, costs, buffer, out, sizes, ends
):
    """Encodes a block in packets of at most `most` bytes, as many tracks to each as fit; returns how many packets.

    Args:
        models: int64 (contexts, 2), of every packet.
        counts: int64 (contexts, 2), how often each bit was coded in packets that were kept; added to.
        frames: Frames of the group, F.
        first_new: The first track that is new in the group.
        dead: See `follow_neighbours`.
        heads: int64 (n, HEAD), ascending by track.
        places: int64 (n, 3), of the bases, half lattice units.
        shifts: int64 (n, C), log2 of the steps.
        targets: float64 (N, C, F), coefficients as they are.
        rows: int64 (n), of which targets.
        most: Bytes.
        costs: Bytes that each track is expected to take, above 0, float64 (n): the better, the fewer tries.
        buffer: uint8, filled with the payloads one after another.
        out: int32 (n, C, F), filled with residuals.
        sizes: int64 (n), filled with tracks of each packet.
        ends: int64 (n), filled with ends of payloads in the buffer.
    """
    total, begin, at, packets = len(heads), 0, 0, 0
    aim, scale = most - (most >> AIM), 1.0
    kept = np.zeros((NUM_CONTEXTS, 2), np.int64)
    while begin < total:
        left = _candidates(heads, begin, total - begin)
        low, high, tries, last, length = 0, left + 1, 0, 0, 0
        n = _expected(costs, begin, begin + left, scale, aim)
        while high - low > 1 or last != low:
            n = n if high - low > 1 else low
            kept[:] = 0
            some = slice(begin, begin + n)
            length = _encode_packet(
                models, kept, frames, first_new, dead, heads[some], places[some], shifts[some], targets, rows[some],
                buffer[at:], out[some],
            )  # fmt: skip
            tries, last = tries + 1, n
            scale = max(length, 1) / costs[begin : begin + n].sum()
            if length <= most or n == 1:
                low = n
                if n == left or length >= most - (most >> ENOUGH) or tries > 6:
                    break
            else:
                high = n
            n = min(max(_expected(costs, begin, begin + left, scale, aim), low + 1), high - 1)
        counts += kept
        at += length
        sizes[packets], ends[packets] = low, at
        begin += low
        packets += 1
    return packets


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_packets(models, frames, first_new, data, ends, starts, heads, orders, quantised):
    """Decodes packets; packet p has the rows `starts[p]:starts[p + 1]` and bytes `ends[p]:ends[p + 1]`.

    `orders`, int64 (packets, kinds), and the rows, int64 (n, HEAD) and int32 (n, C, F), are filled, zero before.
    """
    statistics = np.zeros((1, 2), np.int64), np.zeros((1, 1, 1, 2), np.int64)
    for p in range(len(starts) - 1):
        coder = new_coder(DECODING, data, ends[p + 1], models.copy(), statistics, _tables())
        decoder_start(data, ends[p], ends[p + 1], coder.state)
        rows = slice(starts[p], starts[p + 1])
        code_motion(
            coder, heads[rows], starts[p + 1] - starts[p], orders[p], quantised[rows], frames, first_new
        )  # fmt: skip
