"""Numba kernels that predict the motion of a track from that of its neighbours in the packet: integers throughout."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.tracks._near_kernels import LANES, know, nearest
from splatwire.codec.schemas.tracks.layout import (
    KIND_OF,
    MAX_COEFFICIENT,
    MAX_QUANTISED,
    MOVING,
    NUM_CHANNELS,
    NUM_NEIGHBOURS,
    PLACE_BITS,
    WEIGHT_BITS,
)
from splatwire.ops.compiled import njit

_RADIUS = 1 << 10
"""Offsets of neighbours are rounded to so many steps of the farthest one's."""
_SPREAD_BITS, _PULL_BITS = 16, 33
"""Bits that are left of second moments, and of what they are multiplied with: products of both stay below 2**53."""
_RIDGE_BITS, _LEAST_RIDGE = 14, 4
"""Second moments are raised by so small a share of theirs, so that a slope is known even of neighbours in a line. What
moves far moves much more than a step: an eighth of it added would cost six times the bytes of an object that turns."""
_TURN_BITS = 20
_OCTAVES = 1
"""Tracks whose steps of place and turn are alike within `2 ** _OCTAVES` octaves in all are predicted side by side."""
_MOST = 1.0 * MAX_COEFFICIENT
ONE = np.int64(1)


@njit(error_model="numpy")
@no_type_check
def shrunk(places):
    """Places relative to the lowest corner, in units so large that `PLACE_BITS` suffice, int64 (M, 3)."""
    out, extent = places.copy(), np.int64(0)
    for a in range(3):
        low, high = places[0, a], places[0, a]
        for i in range(len(places)):
            low, high = min(low, places[i, a]), max(high, places[i, a])
        extent = max(extent, high - low)
        for i in range(len(places)):
            out[i, a] -= low
    shift = 0
    while extent >> shift >= ONE << PLACE_BITS:
        shift += 1
    for i in range(len(places)):
        for a in range(3):
            out[i, a] >>= shift
    return out


@njit(error_model="numpy")
@no_type_check
def coarse_to_fine(places, moving, shifts):
    """Order in which moving tracks are predicted, int64 (n): those of fine steps first, for they tell the most.

    Of like steps along a Z-order curve by ever smaller strides, so that most have neighbours on all sides. `places`,
    int64 (M, 3), are as `shrunk` returns them; `moving`, int64 (n); `shifts`, int64 (M, C).
    """
    n = len(moving)
    codes = np.zeros(n, np.int64)
    for i in range(n):
        for bit in range(10):
            for a in range(3):
                codes[i] |= ((places[moving[i], a] >> (PLACE_BITS - 10 + bit)) & 1) << (3 * bit + a)
    by = np.argsort(codes, kind="mergesort")
    order, count, bits = np.empty(n, np.int64), 0, 0
    while (1 << bits) < n:
        bits += 1
    for slot in range(1 << bits):
        back = np.int64(0)
        for bit in range(bits):
            back |= ((slot >> bit) & 1) << (bits - 1 - bit)
        if back < n:
            order[count] = moving[by[back]]
            count += 1
    keys = np.empty(n, np.int64)
    for i in range(n):
        keys[i] = (shifts[order[i], 0] + shifts[order[i], 3]) >> _OCTAVES
    return order[np.argsort(keys, kind="mergesort")]


@njit(borrows=True, error_model="numpy")
@no_type_check
def _weigh(places, i, who, far, found, offsets, near, weights):
    """Weights of neighbours, out of `1 << WEIGHT_BITS`, that add up to one: the least-squares plane through them at i.

    Numbers stay below 2**53, so that doubles hold them: see `docs/format.md`.
    """
    for m in range(found):
        weights[m] = (ONE << WEIGHT_BITS) // found
    if found >= 4:
        radius = ONE
        for m in range(found):
            for a in range(3):
                radius = max(radius, abs(places[who[m], a] - places[i, a]))
        _plane(places, i, who, far, found, radius, offsets, near, weights)
    left = ONE << WEIGHT_BITS
    for m in range(found):
        left -= weights[m]
    if found:
        weights[0] += left


@njit(borrows=True, error_model="numpy")
@no_type_check
def _plane(places, i, who, far, found, radius, offsets, near, weights):
    total = np.int64(0)
    x = y = z = xx = xy = xz = yy = yz = zz = np.int64(0)
    for m in range(found):
        # Below 2**53 a quotient of doubles that is rounded down is the integers', and takes a fifth of the time.
        near[m] = w = 1 + np.int64(np.float64(2 * (far[0] + 1)) / np.float64(far[m] + 1))
        for a in range(3):
            offset = (places[who[m], a] - places[i, a]) * _RADIUS
            offsets[m, a] = np.int64(np.floor(np.float64(offset) / np.float64(radius)))
        ox, oy, oz = offsets[m, 0], offsets[m, 1], offsets[m, 2]
        total += w
        x, y, z = x + w * ox, y + w * oy, z + w * oz
        xx, xy, xz = xx + w * ox * ox, xy + w * ox * oy, xz + w * ox * oz
        yy, yz, zz = yy + w * oy * oy, yz + w * oy * oz, zz + w * oz * oz
    xx, xy, xz = total * xx - x * x, total * xy - x * y, total * xz - x * z
    yy, yz, zz = total * yy - y * y, total * yz - y * z, total * zz - z * z
    trace, spread = xx + yy + zz, 0
    while trace >> spread >= ONE << _SPREAD_BITS:
        spread += 1
    ridge = (trace >> (spread + _RIDGE_BITS)) + _LEAST_RIDGE
    xx, yy, zz = (xx >> spread) + ridge, (yy >> spread) + ridge, (zz >> spread) + ridge
    xy, xz, yz = xy >> spread, xz >> spread, yz >> spread
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = max(xx * a + xy * b + xz * c, ONE)
    hx, hy, hz = a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z
    pull = 0
    while max(abs(hx), abs(hy), abs(hz)) >> pull >= ONE << _PULL_BITS:
        pull += 1
    hx, hy, hz = hx >> pull, hy >> pull, hz >> pull
    scale = 2.0 ** (_TURN_BITS + pull - spread)
    for m in range(found):
        moment = hx * (total * offsets[m, 0] - x) + hy * (total * offsets[m, 1] - y) + hz * (total * offsets[m, 2] - z)
        turn = np.int64(np.floor(np.float64(moment) / np.float64(determinant) * scale + 0.5))
        part, whole = near[m] * ((ONE << _TURN_BITS) - turn), total << (_TURN_BITS - WEIGHT_BITS)
        share = np.int64(np.floor(np.float64(part) / np.float64(whole)))
        weights[m] = min(max(share, -(ONE << WEIGHT_BITS)), ONE << WEIGHT_BITS)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _means(known, moving, who, weights, found, means):
    """What neighbours make expected; a sum of products stays below 2**53, so that doubles hold it."""
    means[:] = 0.0
    for m in range(found):
        if moving[who[m]]:
            weight, row = np.float64(weights[m]), known[who[m]]
            for u in range(len(means)):
                means[u] += weight * row[u]
    for u in range(len(means)):
        means[u] = np.floor(means[u] * (1.0 / (1 << WEIGHT_BITS)) + 0.5)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _quantise(wanted, means, octaves, dead, steps):
    """Residuals in steps; what is less than half a step and `dead` out of 64 steps more becomes 0."""
    for u in range(len(means)):
        value = np.int64(np.rint(wanted[u]) - means[u])
        some = (abs(value) + ((ONE << octaves[u]) >> 1) - ((dead << octaves[u]) >> 6)) >> octaves[u]
        some = min(max(some, 0), MAX_QUANTISED)
        steps[u] = some if value >= 0 else -some


@njit(borrows=True, error_model="numpy")
@no_type_check
def _settle(means, octaves, steps, row):
    """Coefficients of a track from what is expected of them and residuals in steps."""
    for u in range(len(means)):
        value = means[u] + np.float64(steps[u] << octaves[u])
        row[u] = min(max(value, -_MOST), _MOST)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _put(flat, orders, rows):
    """Puts what stands side by side, (M, U), in its places, (M, C, F)."""
    for i in range(len(rows)):
        u = 0
        for c in range(NUM_CHANNELS):
            for k in range(orders[KIND_OF[c]]):
                rows[i, c, k] = flat[i, u]
                u += 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def take(values, rows, states, orders, flat):
    """Puts coefficients that are coded, of rows of (N, C, F), side by side, (M, U), of tracks that move."""
    for i in range(len(rows)):
        if states[i] != MOVING:
            continue
        u = 0
        for c in range(NUM_CHANNELS):
            for k in range(orders[KIND_OF[c]]):
                flat[i, u] = values[rows[i], c, k]
                u += 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def follow_neighbours(places, states, shifts, orders, quantised, wanted, dead, coefficients):
    """Coefficients of a packet's tracks from their residuals, or, of an encoder, residuals from what is wanted.

    Args:
        places: int64 (M, 3), of the bases.
        states: int64 (M).
        shifts: int64 (M, C), log2 of the steps.
        orders: int64 (kinds), how many coefficients of each kind are coded.
        quantised: int32 (M, C, F), residuals in steps; filled by an encoder.
        wanted: float64 (M, U) of an encoder, see `take`; of length 0 for a decoder.
        dead: How much an encoder favours 0, out of 64 steps.
        coefficients: float32 (M, C, K) of a decoder, zero before, filled; of length 0 for an encoder.
    """
    if not len(places):
        return
    near, used = shrunk(places), 0
    for c in range(NUM_CHANNELS):
        used += orders[KIND_OF[c]]
    moving = states == MOVING
    known, around, squares = np.empty(len(places), np.int64), np.empty((3, len(places))), np.empty(len(places))
    count = 0
    for i in range(len(places)):
        if not moving[i]:
            count = know(near, i, known, around, count)
    lanes, some = np.empty(LANES), np.empty(len(places), np.int64)
    values, means, steps = np.zeros((len(places), used)), np.empty(used), np.zeros((len(places), used), np.int64)
    octaves = np.empty(used, np.int64)
    if not len(wanted):
        take(quantised, np.arange(len(places)), states, orders, steps)
    who, far = np.empty(NUM_NEIGHBOURS, np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    offsets, closeness = np.empty((NUM_NEIGHBOURS, 3), np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    weights = np.empty(NUM_NEIGHBOURS, np.int64)
    for i in coarse_to_fine(near, np.flatnonzero(moving), shifts):
        found = nearest(near, known, around, count, i, squares, lanes, some, who, far)
        _weigh(near, i, who, far, found, offsets, closeness, weights)
        _means(values, moving, who, weights, found, means)
        u = 0
        for c in range(NUM_CHANNELS):
            for _ in range(orders[KIND_OF[c]]):
                octaves[u] = shifts[i, c]
                u += 1
        if len(wanted):
            _quantise(wanted[i], means, octaves, dead, steps[i])
        _settle(means, octaves, steps[i], values[i])
        count = know(near, i, known, around, count)
    if len(wanted):
        _put(steps, orders, quantised)
    _put(values, orders, coefficients)
