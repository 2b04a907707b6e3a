"""Numba kernels that predict the motion of a track from that of its neighbours in the packet: integers throughout."""

from typing import no_type_check

import numpy as np

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
def _know(places, i, known, around, count):
    """Takes a track among the known ones: its number, and its place in columns, which are searched side by side."""
    known[count] = i
    for a in range(3):
        around[a, count] = places[i, a]
    return count + 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def _nearest(places, known, around, count, i, squares, who, far):
    """The nearest of the `count` tracks in `known`, nearest first; returns how many. Of equals the earlier one."""
    found = 0
    x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
    for m in range(count):
        dx, dy, dz = around[0, m] - x, around[1, m] - y, around[2, m] - z
        squares[m] = dx * dx + dy * dy + dz * dz  # below 2**53: doubles hold it
    for m in range(count):
        if found == NUM_NEIGHBOURS and squares[m] >= far[found - 1]:
            continue
        d = np.int64(squares[m])
        at = found if found < NUM_NEIGHBOURS else found - 1
        while at > 0 and far[at - 1] > d:
            far[at], who[at] = far[at - 1], who[at - 1]
            at -= 1
        far[at], who[at] = d, known[m]
        found = min(found + 1, NUM_NEIGHBOURS)
    return found


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
        near[m] = w = 1 + (2 * (far[0] + 1)) // (far[m] + 1)
        for a in range(3):
            offsets[m, a] = (places[who[m], a] - places[i, a]) * _RADIUS // radius
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
        share = (near[m] * ((ONE << _TURN_BITS) - turn)) // (total << (_TURN_BITS - WEIGHT_BITS))
        weights[m] = min(max(share, -(ONE << WEIGHT_BITS)), ONE << WEIGHT_BITS)


@njit(error_model="numpy")
@no_type_check
def _used(orders):
    """Which coefficients are coded: how many, and for each its channel and order, int64 (U, 2)."""
    used = np.empty((NUM_CHANNELS * orders.max(), 2), np.int64)
    count = 0
    for c in range(NUM_CHANNELS):
        for k in range(orders[KIND_OF[c]]):
            used[count, 0], used[count, 1] = c, k
            count += 1
    return used[:count]


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
def _quantise(targets, means, used, shifts, dead, quantised):
    """Residuals in steps; what is less than half a step and `dead` out of 64 steps more becomes 0."""
    for u in range(len(used)):
        c, k = used[u, 0], used[u, 1]
        shift = shifts[c]
        value = np.int64(np.rint(targets[c, k]) - means[u])
        steps = (abs(value) + ((ONE << shift) >> 1) - ((dead << shift) >> 6)) >> shift
        steps = min(max(steps, 0), MAX_QUANTISED)
        quantised[c, k] = steps if value >= 0 else -steps


@njit(nogil=True, error_model="numpy")
@no_type_check
def follow_neighbours(places, states, shifts, orders, quantised, targets, dead, coefficients):
    """Coefficients of a packet's tracks from their residuals, or, of an encoder, residuals from what is wanted.

    Args:
        places: int64 (M, 3), of the bases.
        states: int64 (M).
        shifts: int64 (M, C), log2 of the steps.
        orders: int64 (kinds), how many coefficients of each kind are coded.
        quantised: int32 (M, C, F), residuals in steps; filled by an encoder.
        targets: float64 (M, C, F) of an encoder; of length 0 for a decoder.
        dead: How much an encoder favours 0, out of 64 steps.
        coefficients: int64 (M, C, F) of a decoder, zero before, filled; of length 0 for an encoder.
    """
    if not len(places):
        return
    near, used = shrunk(places), _used(orders)
    moving = states == MOVING
    known, around, squares = np.empty(len(places), np.int64), np.empty((3, len(places))), np.empty(len(places))
    count = 0
    for i in range(len(places)):
        if not moving[i]:
            count = _know(near, i, known, around, count)
    values, means = np.zeros((len(places), len(used))), np.empty(len(used))
    who, far = np.empty(NUM_NEIGHBOURS, np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    offsets, closeness = np.empty((NUM_NEIGHBOURS, 3), np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    weights = np.empty(NUM_NEIGHBOURS, np.int64)
    for i in coarse_to_fine(near, np.flatnonzero(moving), shifts):
        found = _nearest(near, known, around, count, i, squares, who, far)
        _weigh(near, i, who, far, found, offsets, closeness, weights)
        _means(values, moving, who, weights, found, means)
        if len(targets):
            _quantise(targets[i], means, used, shifts[i], dead, quantised[i])
        for u in range(len(used)):
            c, k = used[u, 0], used[u, 1]
            value = means[u] + np.float64(np.int64(quantised[i, c, k]) << shifts[i, c])
            values[i, u] = min(max(value, -MAX_COEFFICIENT), MAX_COEFFICIENT)
        count = _know(near, i, known, around, count)
    if len(coefficients):
        for i in range(len(places)):
            for u in range(len(used)):
                coefficients[i, used[u, 0], used[u, 1]] = np.int64(values[i, u])
