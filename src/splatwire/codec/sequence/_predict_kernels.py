"""Numba kernels that predict the motion of a track (Gaussian over time) from its neighbours.

The predictions are identical on every machine.
"""

from typing import no_type_check

import numpy as np

from splatwire.codec.sequence._near_kernels import LANES, add_known, nearest
from splatwire.codec.sequence.layout import (
    KIND_OF,
    MAX_COEFFICIENT,
    MAX_QUANTISED,
    MOVING,
    NUM_CHANNELS,
    NUM_NEIGHBOURS,
    POSITION_BITS,
    WEIGHT_BITS,
)
from splatwire.ops.compiled import njit

_RADIUS = 1 << 10
"""Largest magnitude of neighbours' offsets after scaling to integers: the offset of the farthest neighbour."""
_MOMENT_BITS, _SOLUTION_BITS = 16, 33
"""Number of bits kept of second moments, and of the values multiplied with second moments; products stay below 2**53.
"""
_RIDGE_BITS, _MIN_RIDGE = 14, 4
"""Relative value added to the diagonal of second moments (ridge), so that the plane fit is defined for collinear
neighbours. Larger values cost bytes for fast motion: a ridge of an eighth would cost six times the bytes for a rotating
object.
"""
_TILT_BITS = 20
"""Number of fractional bits of the tilt, which corrects a neighbour's weight for the slope of the fitted plane."""
_STEP_RANGE_BITS = 1
"""log2 of the number of octaves in a range of quantisation steps. Tracks are sorted by the range that contains the
product of their steps of position and rotation.
"""
_MAX_VALUE = 1.0 * MAX_COEFFICIENT
ONE = np.int64(1)


@njit(error_model="numpy")
@no_type_check
def relative_positions(positions):
    """Returns positions relative to the corner of their bounding box, int64 (M, 3).

    Positions of more than `POSITION_BITS` bits are divided by a power of two that makes them fit.
    """
    out, extent = positions.copy(), np.int64(0)
    for a in range(3):
        low, high = positions[0, a], positions[0, a]
        for i in range(len(positions)):
            low, high = min(low, positions[i, a]), max(high, positions[i, a])
        extent = max(extent, high - low)
        for i in range(len(positions)):
            out[i, a] -= low
    # With at most `POSITION_BITS` bits, later computations are exact.
    shift = 0
    while extent >> shift >= ONE << POSITION_BITS:
        shift += 1
    for i in range(len(positions)):
        for a in range(3):
            out[i, a] >>= shift
    return out


@njit(error_model="numpy")
@no_type_check
def prediction_order(positions, moving, shifts):
    """Sorts the moving tracks (Gaussians over time) of a packet into the order in which their motion is predicted.

    Tracks with finer quantisation steps come first. Among tracks with similar steps, the order is from coarse to dense:
    the first tracks are spread over the packet's region, and later tracks fill the gaps.

    Args:
        positions: Positions of the packet's tracks from `relative_positions`, int64 (M, 3).
        moving: Indices in `positions` of the moving tracks, int64 (n).
        shifts: log2 of the quantisation steps of motion, int64 (M, channels).

    Returns:
        Indices in `positions` of the moving tracks, in the order in which their motion is predicted, int64 (n).
    """
    n = len(moving)
    codes = np.zeros(n, np.int64)
    for i in range(n):
        for bit in range(10):
            for a in range(3):
                codes[i] |= ((positions[moving[i], a] >> (POSITION_BITS - 10 + bit)) & 1) << (3 * bit + a)
    curve_order = np.argsort(codes, kind="mergesort")
    order, count, bits = np.empty(n, np.int64), 0, 0
    while (1 << bits) < n:
        bits += 1
    for slot in range(1 << bits):
        reversed_slot = np.int64(0)
        for bit in range(bits):
            reversed_slot |= ((slot >> bit) & 1) << (bits - 1 - bit)
        if reversed_slot < n:
            order[count] = moving[curve_order[reversed_slot]]
            count += 1
    # In this order, most tracks have known neighbours on all sides.
    keys = np.empty(n, np.int64)
    for i in range(n):
        keys[i] = (shifts[order[i], 0] + shifts[order[i], 3]) >> _STEP_RANGE_BITS
    return order[np.argsort(keys, kind="mergesort")]


@njit(borrows=True, error_model="numpy")
@no_type_check
def _neighbour_weights(positions, i, neighbours, squared_distances, num_neighbours, offsets, distance_weights, weights):
    """Computes the weights of a moving Gaussian's neighbours for the prediction of its motion.

    Args:
        positions: Positions of the packet's tracks from `relative_positions`, int64 (M, 3).
        i: Index of the track.
        neighbours: Indices of the neighbours.
        squared_distances: Squared distances of the neighbours from the track.
        num_neighbours: Number of neighbours.
        offsets: Working array, int64 (NUM_NEIGHBOURS, 3).
        distance_weights: Working array, int64 (NUM_NEIGHBOURS).
        weights: Output: weights of the neighbours, int64 (NUM_NEIGHBOURS).
    """
    for m in range(num_neighbours):
        weights[m] = (ONE << WEIGHT_BITS) // num_neighbours
    # A plane fitted to the neighbours' values by least squares, evaluated at the track's position. All values are
    # below 2**53 and therefore exact in float64.
    if num_neighbours >= 4:
        radius = ONE
        for m in range(num_neighbours):
            for a in range(3):
                radius = max(radius, abs(positions[neighbours[m], a] - positions[i, a]))
        _plane_weights(
            positions, i, neighbours, squared_distances, num_neighbours, radius, offsets, distance_weights, weights
        )
    left = ONE << WEIGHT_BITS
    for m in range(num_neighbours):
        left -= weights[m]
    if num_neighbours:
        weights[0] += left


@njit(borrows=True, error_model="numpy")
@no_type_check
def _plane_weights(
    positions, i, neighbours, squared_distances, num_neighbours, radius, offsets, distance_weights, weights
):
    total = np.int64(0)
    x = y = z = xx = xy = xz = yy = yz = zz = np.int64(0)
    for m in range(num_neighbours):
        # Below 2**53 the rounded-down quotient of doubles equals the integer quotient, and takes a fifth of the time.
        distance_weights[m] = w = 1 + np.int64(
            np.float64(2 * (squared_distances[0] + 1)) / np.float64(squared_distances[m] + 1)
        )
        for a in range(3):
            offset = (positions[neighbours[m], a] - positions[i, a]) * _RADIUS
            offsets[m, a] = np.int64(np.floor(np.float64(offset) / np.float64(radius)))
        ox, oy, oz = offsets[m, 0], offsets[m, 1], offsets[m, 2]
        total += w
        x, y, z = x + w * ox, y + w * oy, z + w * oz
        xx, xy, xz = xx + w * ox * ox, xy + w * ox * oy, xz + w * ox * oz
        yy, yz, zz = yy + w * oy * oy, yz + w * oy * oz, zz + w * oz * oz
    xx, xy, xz = total * xx - x * x, total * xy - x * y, total * xz - x * z
    yy, yz, zz = total * yy - y * y, total * yz - y * z, total * zz - z * z
    trace, moment_shift = xx + yy + zz, 0
    while trace >> moment_shift >= ONE << _MOMENT_BITS:
        moment_shift += 1
    ridge = (trace >> (moment_shift + _RIDGE_BITS)) + _MIN_RIDGE
    xx, yy, zz = (xx >> moment_shift) + ridge, (yy >> moment_shift) + ridge, (zz >> moment_shift) + ridge
    xy, xz, yz = xy >> moment_shift, xz >> moment_shift, yz >> moment_shift
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = max(xx * a + xy * b + xz * c, ONE)
    hx, hy, hz = a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z
    solution_shift = 0
    while max(abs(hx), abs(hy), abs(hz)) >> solution_shift >= ONE << _SOLUTION_BITS:
        solution_shift += 1
    hx, hy, hz = hx >> solution_shift, hy >> solution_shift, hz >> solution_shift
    scale = 2.0 ** (_TILT_BITS + solution_shift - moment_shift)
    for m in range(num_neighbours):
        moment = hx * (total * offsets[m, 0] - x) + hy * (total * offsets[m, 1] - y) + hz * (total * offsets[m, 2] - z)
        tilt = np.int64(np.floor(np.float64(moment) / np.float64(determinant) * scale + 0.5))
        part, whole = distance_weights[m] * ((ONE << _TILT_BITS) - tilt), total << (_TILT_BITS - WEIGHT_BITS)
        share = np.int64(np.floor(np.float64(part) / np.float64(whole)))
        weights[m] = min(max(share, -(ONE << WEIGHT_BITS)), ONE << WEIGHT_BITS)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _predict_coefficients(coefficients, moving, neighbours, weights, num_neighbours, predicted):
    """Predicts the motion coefficients of a track (Gaussian over time) as a weighted mean over its neighbours.

    Args:
        coefficients: Decoded coefficients of the packet's M tracks, float64 (M, U), with U coefficients per track.
        moving: Mask of moving tracks, (M).
        neighbours: Indices of the neighbours.
        weights: Weights of the neighbours, from `_neighbour_weights`.
        num_neighbours: Number of neighbours.
        predicted: Output: predicted coefficients, float64 (U).
    """
    # Sums of products stay below 2**53, so that they are exact in float64.
    predicted[:] = 0.0
    for m in range(num_neighbours):
        if moving[neighbours[m]]:
            weight, row = np.float64(weights[m]), coefficients[neighbours[m]]
            for u in range(len(predicted)):
                predicted[u] += weight * row[u]
    for u in range(len(predicted)):
        predicted[u] = np.floor(predicted[u] * (1.0 / (1 << WEIGHT_BITS)) + 0.5)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _quantise(targets, predicted, log2_steps, dead_zone, residuals):
    """Quantises the differences of a Gaussian's motion coefficients from their prediction.

    Args:
        targets: The U coefficients before quantisation, float64 (U).
        predicted: Predicted coefficients, float64 (U).
        log2_steps: log2 of the quantisation step of each coefficient, int64 (U).
        dead_zone: Extra width of the interval that the quantiser rounds to 0 (dead zone), in 64ths of a step.
        residuals: Output: residuals, int64 (U).
    """
    # Small differences become 0 even if they exceed half a step, because zeros take few bits.
    for u in range(len(predicted)):
        value = np.int64(np.rint(targets[u]) - predicted[u])
        magnitude = (abs(value) + ((ONE << log2_steps[u]) >> 1) - ((dead_zone << log2_steps[u]) >> 6)) >> log2_steps[u]
        magnitude = min(max(magnitude, 0), MAX_QUANTISED)
        residuals[u] = magnitude if value >= 0 else -magnitude


@njit(borrows=True, error_model="numpy")
@no_type_check
def _reconstruct(predicted, log2_steps, residuals, row):
    """Reconstructs the motion coefficients of a track (Gaussian over time): prediction plus dequantised residuals.

    Args:
        predicted: The U predicted coefficients, float64 (U).
        log2_steps: log2 of the quantisation step of each coefficient, int64 (U).
        residuals: Residuals in quantisation steps, int64 (U).
        row: Output: the coefficients, float64 (U).
    """
    for u in range(len(predicted)):
        value = predicted[u] + np.float64(residuals[u] << log2_steps[u])
        row[u] = min(max(value, -_MAX_VALUE), _MAX_VALUE)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _unpack_coefficients(flat, num_coefficients, rows):
    """Distributes the motion coefficients of M tracks (Gaussians over time) to channels and degrees.

    Args:
        flat: The coefficients that the packet contains, (M, U), with U coefficients per track.
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of polynomial
            coefficients coded per channel, int64 (kinds).
        rows: Output: the coefficients, (M, channels, frames). The last axis is the degree, which is below the number of
            frames.
    """
    for i in range(len(rows)):
        u = 0
        for c in range(NUM_CHANNELS):
            for k in range(num_coefficients[KIND_OF[c]]):
                rows[i, c, k] = flat[i, u]
                u += 1


@njit(borrows=True, error_model="numpy")
@no_type_check
def pack_coefficients(values, rows, states, num_coefficients, flat):
    """Gathers the motion coefficients that a packet contains into one array row per track (Gaussian over time).

    Args:
        values: Coefficients by channel and degree, (N, channels, frames).
        rows: Index in `values` of each track, int64 (M).
        states: `STILL` or `MOVING` for each track, int64 (M).
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of polynomial
            coefficients coded per channel, int64 (kinds).
        flat: Output: the coded coefficients, (M, U), with U coefficients per track.
    """
    for i in range(len(rows)):
        if states[i] != MOVING:
            continue
        u = 0
        for c in range(NUM_CHANNELS):
            for k in range(num_coefficients[KIND_OF[c]]):
                flat[i, u] = values[rows[i], c, k]
                u += 1


@njit(nogil=True, error_model="numpy")
@no_type_check
def predict_from_neighbours(positions, states, shifts, num_coefficients, quantised, targets, dead_zone, coefficients):
    """Quantises or reconstructs the motion of a packet's M tracks (Gaussians over time), predicted from neighbours.

    The motion of a track is described by U polynomial coefficients: U is the total number of coefficients of all
    channels. Each coefficient is predicted from neighbouring tracks. Its residual is the difference from the
    prediction, in quantisation steps. An encoder computes the residuals from the coefficients. A decoder computes the
    coefficients from the residuals.

    Args:
        positions: Positions of the keyframe Gaussians of the packet's M tracks, in units of motion, int64 (M, 3).
        states: `STILL` or `MOVING` for each track, int64 (M).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (M, channels).
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of polynomial
            coefficients coded per channel, int64 (kinds).
        quantised: Residuals, int32 (M, channels, frames): output of an encoder, input of a decoder.
        targets: Input of an encoder: the coefficients from `pack_coefficients`, float64 (M, U). An array of length 0
            selects decoding.
        dead_zone: For an encoder, dead zone of the quantiser: extra width of the interval that is rounded to 0, in
            64ths of a quantisation step.
        coefficients: Output of a decoder: the reconstructed coefficients, float32 (M, channels, K), where K
            is the largest of `num_coefficients`. The array must be 0 before the call. An encoder passes an array of
            length 0.
    """
    if not len(positions):
        return
    relative, num_used = relative_positions(positions), 0
    for c in range(NUM_CHANNELS):
        num_used += num_coefficients[KIND_OF[c]]
    moving = states == MOVING
    known_tracks, known_positions, squares = (
        np.empty(len(positions), np.int64),
        np.empty((3, len(positions))),
        np.empty(len(positions)),
    )
    count = np.int64(0)  # numba would compile `nearest` a second time for the literal 0
    for i in range(len(positions)):
        if not moving[i]:
            count = add_known(relative, i, known_tracks, known_positions, count)
    group_minima, nearest_candidates = np.empty(LANES), np.empty(len(positions), np.int64)
    decoded, predicted, residuals = (
        np.zeros((len(positions), num_used)),
        np.empty(num_used),
        np.zeros((len(positions), num_used), np.int64),
    )
    log2_steps = np.empty(num_used, np.int64)
    if not len(targets):
        pack_coefficients(quantised, np.arange(len(positions)), states, num_coefficients, residuals)
    neighbours, squared_distances = np.empty(NUM_NEIGHBOURS, np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    offsets, distance_weights = np.empty((NUM_NEIGHBOURS, 3), np.int64), np.empty(NUM_NEIGHBOURS, np.int64)
    weights = np.empty(NUM_NEIGHBOURS, np.int64)
    for i in prediction_order(relative, np.flatnonzero(moving), shifts):
        num_neighbours = nearest(
            relative,
            known_tracks,
            known_positions,
            count,
            i,
            squares,
            group_minima,
            nearest_candidates,
            neighbours,
            squared_distances,
        )
        _neighbour_weights(
            relative, i, neighbours, squared_distances, num_neighbours, offsets, distance_weights, weights
        )
        _predict_coefficients(decoded, moving, neighbours, weights, num_neighbours, predicted)
        u = 0
        for c in range(NUM_CHANNELS):
            for _ in range(num_coefficients[KIND_OF[c]]):
                log2_steps[u] = shifts[i, c]
                u += 1
        if len(targets):
            _quantise(targets[i], predicted, log2_steps, dead_zone, residuals[i])
        _reconstruct(predicted, log2_steps, residuals[i], decoded[i])
        count = add_known(relative, i, known_tracks, known_positions, count)
    if len(targets):
        _unpack_coefficients(residuals, num_coefficients, quantised)
    _unpack_coefficients(decoded, num_coefficients, coefficients)
