"""Numba kernels that generate the Gaussians of anchors with the networks of a scene.

A SIMD vector has sixteen elements (lanes). The hidden layers process sixteen anchors at a time, one per lane. The
output layers process one Gaussian at a time, one network output per lane. The module `head_gradients` does the same
computation with numpy.

Common arguments: `anchors` (positions, features, scalings, offsets, mask); `hints` (result of loss concealment: hidden
anchors, factors on size, factors on opacity; empty arrays if there is none); `camera` (pose, focal lengths and
principal point, centre, width, height, near plane).
"""

import math
from typing import no_type_check

import numpy as np

from splatwire.anchors.projection import DILATION, FRUSTUM_MARGIN, TILE
from splatwire.ops.compiled import njit
from splatwire.ops.lanes import LANES, choose, load, pick, power_of_two, smaller, spread, store

ROWS = 6
"""Number of outputs computed together; weights are padded to a multiple of this number of outputs."""
COLOR = 8
"""Index of the red channel among a Gaussian's outputs; the three scale logits and the quaternion precede the colour."""
_LOG2E = np.float32(1.4426950408889634)
_MAX_POWER, _ZERO, _ONE = np.float32(126), np.float32(0), np.float32(1)
_MIN_ALPHA, _MIN_NORM = 1.0 / 255.0, np.float32(1e-12)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _layer(packed, num_inputs, num_groups, x, slope, out):
    """Evaluates a network layer (affine map, leaky ReLU) for sixteen anchors.

    Args:
        packed: Biases and weights in blocks of six outputs: the six biases, then six weights per input.
        num_inputs: Number of inputs.
        num_groups: Number of blocks of six outputs.
        x: Inputs, flat; input i of anchor a is at index `16 * i + a`.
        slope: Factor on negative results; 1 for no activation.
        out: Output: results of the layer, flat; output i of anchor a is at index `16 * i + a`.
    """
    zero = spread(_ZERO)
    for group in range(num_groups):
        at = group * (num_inputs + 1) * ROWS
        a, b, c = spread(pick(packed, at)), spread(pick(packed, at + 1)), spread(pick(packed, at + 2))
        d, e, f = spread(pick(packed, at + 3)), spread(pick(packed, at + 4)), spread(pick(packed, at + 5))
        for i in range(0, num_inputs * LANES, LANES):
            at += ROWS
            value = load(x, i)
            a += value * pick(packed, at)
            b += value * pick(packed, at + 1)
            c += value * pick(packed, at + 2)
            d += value * pick(packed, at + 3)
            e += value * pick(packed, at + 4)
            f += value * pick(packed, at + 5)
        a, b = choose(a >= zero, a, a * slope), choose(b >= zero, b, b * slope)
        c, d = choose(c >= zero, c, c * slope), choose(d >= zero, d, d * slope)
        e, f = choose(e >= zero, e, e * slope), choose(f >= zero, f, f * slope)
        first = group * ROWS * LANES
        store(out, first, a)
        store(out, first + LANES, b)
        store(out, first + 2 * LANES, c)
        store(out, first + 3 * LANES, d)
        store(out, first + 4 * LANES, e)
        store(out, first + 5 * LANES, f)


@njit(inline="always")
@no_type_check
def _in_view(positions, scalings, n, camera):
    """True if anchor `n` may be visible to the camera (pre-filter of HAC++).

    Args:
        positions: Positions of all anchors.
        scalings: Scalings of all anchors; the first three values are the extent of the anchor.
        n: Index of the anchor.
        camera: Pose, intrinsics, centre, width, height and near plane.
    """
    pose, (fx, fy, cx, cy), _, width, height, near_depth = camera
    p0, p1, p2 = np.float64(positions[n, 0]), np.float64(positions[n, 1]), np.float64(positions[n, 2])
    z = pose[2, 0] * p0 + pose[2, 1] * p1 + pose[2, 2] * p2 + pose[2, 3]
    if not z > near_depth:
        return False
    x = (pose[0, 0] * p0 + pose[0, 1] * p1 + pose[0, 2] * p2 + pose[0, 3]) / z
    y = (pose[1, 0] * p0 + pose[1, 1] * p1 + pose[1, 2] * p2 + pose[1, 3]) / z
    u, v = fx * x + (cx - 0.5), fy * y + (cy - 0.5)
    margin_x, margin_y = FRUSTUM_MARGIN * width / (2 * fx), FRUSTUM_MARGIN * height / (2 * fy)
    x = min(max(x, -cx / fx - margin_x), (width - cx) / fx + margin_x)
    y = min(max(y, -cy / fy - margin_y), (height - cy) / fy + margin_y)
    xx = yy = DILATION
    xy = 0.0
    for k in range(3):
        a = fx / z * (pose[0, k] - x * pose[2, k]) * scalings[n, k]
        b = fy / z * (pose[1, k] - y * pose[2, k]) * scalings[n, k]
        xx, xy, yy = xx + a * a, xy + a * b, yy + b * b
    middle = (xx + yy) / 2
    radius = math.ceil(3 * math.sqrt(middle + math.sqrt(max(middle * middle - (xx * yy - xy * xy), 0.1))))
    inside_x = u + radius + TILE - 1 >= TILE and u - radius < math.ceil(width / TILE) * TILE
    return inside_x and v + radius + TILE - 1 >= TILE and v - radius < math.ceil(height / TILE) * TILE


@njit(inline="always")
@no_type_check
def _choose_anchors(n, last, anchors, hints, camera, chosen):
    """Finds the next visible anchors, at most sixteen.

    Args:
        n: Index of the first anchor to test.
        last: End of the anchors to test (exclusive).
        anchors: Arrays of all anchors: positions, features, scalings, offsets and masks.
        hints: Arrays of `RenderHints`; the first is the mask of hidden anchors, empty for none.
        camera: Pose, intrinsics, centre, width, height and near plane.
        chosen: Output: indices of the visible anchors, int64 (16).

    Returns:
        Number of visible anchors found, and index of the next anchor to test.
    """
    count = 0
    while n < last and count < LANES:
        left_out = hints[0].shape[0] > 0 and hints[0][n]
        if not left_out and _in_view(anchors[0], anchors[2], n, camera):
            chosen[count] = n
            count += 1
        n += 1
    return count, n


@njit(inline="always")
@no_type_check
def _fill_inputs(positions, features, center, chosen, count, x):
    """Writes the inputs of the networks for up to sixteen anchors: feature, direction from the camera, distance.

    Args:
        positions: Positions of all anchors.
        features: Features of all anchors.
        center: Camera centre.
        chosen: Indices of the anchors.
        count: Number of these anchors.
        x: Output: inputs of the networks, flat; input i of the anchor `chosen[a]` is at index `16 * i + a`.
    """
    num_features = features.shape[1]
    for lane in range(LANES):
        n = chosen[min(lane, count - 1)]
        for j in range(num_features):
            x[j * LANES + lane] = pick(features, n * num_features + j)
        r0, r1, r2 = positions[n, 0] - center[0], positions[n, 1] - center[1], positions[n, 2] - center[2]
        distance = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        at = num_features * LANES + lane
        x[at], x[at + LANES], x[at + 2 * LANES] = r0 / distance, r1 / distance, r2 / distance
        x[at + 3 * LANES] = distance


@njit(inline="always")
@no_type_check
def _exp_minus(value):
    """Returns e ** -value; clips the exponent so that the result is finite."""
    power = smaller(value * _LOG2E, spread(_MAX_POWER))
    return power_of_two(smaller(_ZERO - power, spread(_MAX_POWER)))


@njit(inline="always")
@no_type_check
def _fill_opacities(logits, mask, gains, chosen, count, opacities):
    """Computes the opacities of the Gaussians of up to sixteen anchors from network outputs.

    Args:
        logits: Outputs of the opacity network, flat (K * 16). Offset k of anchor i is at index `16 * k + i`.
            Overwritten.
        mask: Mask of the existing offsets of all anchors, (N, K).
        gains: Factor on the opacity of each anchor's Gaussians, (N); empty for none.
        chosen: Indices of the anchors.
        count: Number of these anchors, at most sixteen.
        opacities: Output: opacities, (16, K); 0 for Gaussians that are not drawn.

    Returns:
        True if at least one Gaussian is drawn.
    """
    for k in range(mask.shape[1]):
        e = _exp_minus(load(logits, k * LANES) * np.float32(2))
        store(logits, k * LANES, (_ONE - e) / (_ONE + e))
    seen = False
    for lane in range(count):
        n = chosen[lane]
        for k in range(mask.shape[1]):
            opacity = logits[k * LANES + lane]
            exists = mask[n, k] and opacity > 0
            if gains.shape[0] > 0:
                opacity = min(opacity * gains[n], _ONE)
            drawn = exists and np.float64(opacity) >= _MIN_ALPHA
            opacities[lane, k] = opacity if drawn else _ZERO
            seen |= drawn
    return seen


@njit(inline="always")
@no_type_check
def _output(table, row, num_hidden, hidden):
    """Evaluates the output layers of the covariance and the colour network for one Gaussian.

    Args:
        table: Biases and weights of both layers for every offset of an anchor (`compiled_heads._pack_output_layers`).
        row: Index in `table` of the first value for the Gaussian's offset.
        num_hidden: Number of hidden units of each network.
        hidden: Values of the hidden units of both networks.

    Returns:
        Sixteen values: eight of the covariance network, then eight of the colour network.
    """
    a, b, c, d = load(table, row), spread(_ZERO), spread(_ZERO), spread(_ZERO)
    for i in range(0, num_hidden * LANES, 4 * LANES):
        row += 4 * LANES
        a += load(table, row - 3 * LANES) * load(hidden, i)
        b += load(table, row - 2 * LANES) * load(hidden, i + LANES)
        c += load(table, row - LANES) * load(hidden, i + 2 * LANES)
        d += load(table, row) * load(hidden, i + 3 * LANES)
    return (a + b) + (c + d)


@njit(inline="always")
@no_type_check
def _write(n, k, row, anchors, gains, numbers, out):
    """Writes mean, quaternion, scale and colour of one Gaussian to row `row` of the arrays `out`.

    Args:
        n: Index of the Gaussian's anchor.
        k: Index of the Gaussian's offset within the anchor.
        row: Row to write.
        anchors: Arrays of all anchors.
        gains: Factor on the size of each anchor's Gaussians; empty for none.
        numbers: The sixteen network outputs of the Gaussian, followed by the sigmoid of each.
        out: Output arrays: means, quaternions, scales, opacities and colours. The opacities are left unchanged.
    """
    positions, _, scalings, offsets, _ = anchors
    means, quats, scales, _, colors = out
    gain, norm = gains[n] if gains.shape[0] > 0 else _ONE, np.float32(0)
    for c in range(3, 7):
        norm += numbers[c] * numbers[c]
    norm = max(np.sqrt(norm), _MIN_NORM)
    for c in range(3):
        means[row, c] = positions[n, c] + offsets[n, k, c] * scalings[n, c]
        scales[row, c] = scalings[n, 3 + c] * numbers[LANES + c] * gain
        colors[row, c] = numbers[LANES + COLOR + c]
    for c in range(4):
        quats[row, c] = numbers[3 + c] / norm


@njit(nogil=True, error_model="numpy")
@no_type_check
def spawn_block(first, last, anchors, hints, camera, num_hidden, opacity_layers, other_layers, slopes):
    """Generates the Gaussians of the visible anchors in a range, ordered by anchor.

    Args:
        first: Index of the first anchor.
        last: End of the range of anchors (exclusive).
        anchors: Arrays of all anchors: positions, features, scalings, offsets and masks.
        hints: Arrays of `RenderHints`: hidden anchors, factors on size, factors on opacity; empty arrays for none.
        camera: Pose, intrinsics, centre, width, height and near plane.
        num_hidden: Number of hidden units of each network.
        opacity_layers: Hidden layer and output layer of the opacity network, packed for the kernel.
        other_layers: Hidden layers of the covariance and colour networks, and their combined output layers, packed for
            the kernel.
        slopes: Factors on negative hidden units (leaky ReLU) of the opacity, covariance and colour networks.

    Returns:
        Six arrays with one row per Gaussian: means, quaternions, scales, opacities, colours, and pairs of indices. A
        pair has the index of the anchor and the index of the offset within the anchor.
    """
    num_offsets, num_inputs = anchors[4].shape[1], anchors[1].shape[1] + 4
    groups, out_groups, padded = -(-num_hidden // ROWS), -(-num_offsets // ROWS), -(-num_hidden // 4) * 4
    x, both = np.empty(num_inputs * LANES, np.float32), np.zeros(padded * LANES, np.float32)
    hidden, hidden_color = np.empty(groups * ROWS * LANES, np.float32), np.empty(groups * ROWS * LANES, np.float32)
    logits, numbers = np.empty(out_groups * ROWS * LANES, np.float32), np.arange(2 * LANES).astype(np.float32)
    shape_half = load(numbers, 0) <= np.float32(COLOR - 1)
    chosen, opacities = np.empty(LANES, np.int64), np.empty((LANES, num_offsets), np.float32)
    room, at, n = (last - first) * num_offsets, 0, first
    out = (np.empty((room, 3), np.float32), np.empty((room, 4), np.float32), np.empty((room, 3), np.float32),
           np.empty(room, np.float32), np.empty((room, 3), np.float32))  # fmt: skip
    indices = np.empty((room, 2), np.int64)
    while n < last:
        count, n = _choose_anchors(n, last, anchors, hints, camera, chosen)
        if count == 0:
            break
        _fill_inputs(anchors[0], anchors[1], camera[2], chosen, count, x)
        _layer(opacity_layers[0], num_inputs, groups, x, slopes[0], hidden)
        _layer(opacity_layers[1], num_hidden, out_groups, hidden, _ONE, logits)
        if not _fill_opacities(logits, anchors[4], hints[2], chosen, count, opacities):
            continue
        _layer(other_layers[0], num_inputs, groups, x, slopes[1], hidden)
        _layer(other_layers[1], num_inputs, groups, x, slopes[2], hidden_color)
        for lane in range(count):
            for i in range(lane, num_hidden * LANES, LANES):
                either = choose(shape_half, spread(pick(hidden, i)), spread(pick(hidden_color, i)))
                store(both, i - lane, either)
            for k in range(num_offsets):
                if opacities[lane, k] > 0:
                    outputs = _output(other_layers[2], k * (padded + 1) * LANES, num_hidden, both)
                    store(numbers, 0, outputs)
                    store(numbers, LANES, _ONE / (_ONE + _exp_minus(outputs)))
                    _write(chosen[lane], k, at, anchors, hints[1], numbers, out)
                    out[3][at] = opacities[lane, k]
                    indices[at, 0], indices[at, 1] = chosen[lane], k
                    at += 1
    return out[0][:at], out[1][:at], out[2][:at], out[3][:at], out[4][:at], indices[:at]
