"""Numba kernels that encode or decode one principal axis of a Gaussian (primary axis).

It is the axis of the largest or the smallest scale. The rotation about this axis is coded separately.
"""

from typing import no_type_check

import numpy as np

from splatwire.codec._coder_kernels import code_value
from splatwire.codec.gaussians._gaussian_kernels import magnitude_context_of, update_magnitude
from splatwire.codec.gaussians._neighbour_kernels import deviation_context_of
from splatwire.codec.gaussians.layout import AXIS, DIRECTION_BITS, RESIDUAL_DIRECTION
from splatwire.ops.compiled import njit

UNIT = 1 << DIRECTION_BITS


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def predict_axis(neighbours, num_neighbours, primary, axis):
    """Predicts the primary axis of a Gaussian as the weighted sum of its neighbours' primary axes.

    The primary axis is the principal axis of the largest or of the smallest scale. Only neighbours whose primary axis
    is of the same kind are used. The sign of an axis is arbitrary. Each axis is flipped if it points away from the axis
    of the nearest such neighbour.

    Args:
        neighbours: Working arrays of the packet (`Neighbours`), with the neighbours of this Gaussian.
        num_neighbours: Number of neighbours.
        primary: Kind of primary axis: 0 for the axis of the largest scale, 2 for the axis of the smallest scale.
        axis: Output: the weighted sum, int64 (3).

    Returns:
        Weighted mean deviation of the neighbours' axes from the prediction, and number of neighbours used.
    """
    axes, indices, weights = neighbours.axes, neighbours.indices, neighbours.weights
    total = x = y = z = nx = ny = nz = 0.0
    kind, same = np.float64(primary), np.int64(0)
    for m in range(num_neighbours):
        j = indices[m]
        # Only neighbours with a primary axis of the same kind are used. The sign of an axis is arbitrary, so axes are
        # flipped to the side of the nearest neighbour's axis.
        if axes[j, 3] == kind:
            ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
            if same == 0:
                nx, ny, nz = ax, ay, az
            w = weights[m]
            total += w
            w = w if ax * nx + ay * ny + az * nz >= 0.0 else -w
            x, y, z = x + w * ax, y + w * ay, z + w * az
            same += 1
    if same == 0 or (x == 0.0 and y == 0.0 and z == 0.0):
        axis[0], axis[1], axis[2] = 0, 0, UNIT
        return np.int64(0), np.int64(0)
    axis[0], axis[1], axis[2] = x, y, z
    x, y, z = np.floor(x / total), np.floor(y / total), np.floor(z / total)
    deviation = 0.0
    for m in range(num_neighbours):
        j = indices[m]
        if axes[j, 3] == kind:
            ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
            close, opposite = abs(ax - x) + abs(ay - y) + abs(az - z), abs(ax + x) + abs(ay + y) + abs(az + z)
            deviation += weights[m] * min(close, opposite)
    return np.int64(deviation / total), same


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def largest_of(axis):
    """Returns the index of the coordinate with the largest magnitude."""
    pole = 0
    for a in range(1, 3):
        if abs(axis[a]) > abs(axis[pole]):
            pole = a
    return pole


@njit(borrows=True, error_model="numpy")
@no_type_check
def round_axis(source, shift, axis):
    """Quantises an axis to integers, multiples of `1 << shift`, whose magnitudes add up to `UNIT`.

    Args:
        source: The axis, float64 (3), of any length.
        shift: log2 of the quantisation step.
        axis: Output, int64 (3).
    """
    pole = largest_of(source)
    first, second = (pole + 1) % 3, (pole + 2) % 3
    length = abs(source[0]) + abs(source[1]) + abs(source[2])
    factor = 2.0**-shift * UNIT / length if source[pole] >= 0 else -(2.0**-shift) * UNIT / length
    axis[first] = np.int64(np.rint(source[first] * factor)) << shift
    axis[second] = np.int64(np.rint(source[second] * factor)) << shift
    axis[pole] = UNIT - abs(axis[first]) - abs(axis[second])


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _quotient(number, divisor):
    """Divides integers below 2**53, and rounds down."""
    # Float64 arithmetic is faster than integer division.
    return np.int64(np.floor(np.float64(number) / np.float64(divisor)))


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_axis(
    coder, row, primary, source, shift, neighbours, num_neighbours, residual_magnitude, predicted_axis, quantised_axis,
    absolute,
):  # fmt: skip
    """Encodes or decodes the primary axis of a Gaussian, predicted from the axes of its neighbours.

    The primary axis is the principal axis of the largest or of the smallest scale. The rotation about it is coded
    separately.

    Args:
        coder: Entropy coder.
        row: Decoded integers of the Gaussian, int64 (columns); the axis is written.
        primary: Kind of primary axis: 0 for the axis of the largest scale, 2 for the axis of the smallest scale.
        source: The exact axis; only used by an encoder.
        shift: log2 of the quantisation step.
        neighbours: Working arrays of the packet (`Neighbours`), with the neighbours of this Gaussian.
        num_neighbours: Number of neighbours.
        residual_magnitude: Moving average of the magnitudes of preceding residuals, in 16ths of a quantisation step.
        predicted_axis: Working array for the predicted axis, int64 (3).
        quantised_axis: Working array for the quantised axis, int64 (3).
        absolute: True to quantise the value; False, in side information of version 2, to quantise its difference from
            the prediction.

    Returns:
        The updated moving average.
    """
    # Two coordinates are coded, from which the third follows (octahedral mapping).
    # The axis is scaled so that the magnitudes of its coordinates add up to `UNIT`. The coordinate in which the mean
    # axis is largest is left out. With side information of version 2, sum and difference of the other two are coded.
    deviation, same = predict_axis(neighbours, num_neighbours, primary, predicted_axis)
    deviation_context, pole = deviation_context_of(same, deviation, shift), largest_of(predicted_axis)
    if predicted_axis[pole] < 0:
        for a in range(3):
            predicted_axis[a] = -predicted_axis[a]
    first, second = (pole + 1) % 3, (pole + 2) % 3
    norm = abs(predicted_axis[0]) + abs(predicted_axis[1]) + abs(predicted_axis[2])
    p, q = predicted_axis[first], predicted_axis[second]
    source_p, source_q = np.int64(0), np.int64(0)
    if not absolute:
        p, q = p + q, p - q
    if not coder.decoding:
        if absolute:
            round_axis(source, shift, quantised_axis)
            sign = -1 if quantised_axis[pole] < 0 else 1
            source_p, source_q = sign * quantised_axis[first], sign * quantised_axis[second]
        else:
            length = abs(source[0]) + abs(source[1]) + abs(source[2])
            factor = UNIT / length if source[pole] >= 0 else -UNIT / length
            source_p = np.int64(np.rint((source[first] + source[second]) * factor))
            source_q = np.int64(np.rint((source[first] - source[second]) * factor))
    x = y = np.int64(0)
    # A loop, because numba would compile a copy of the entropy coder for each call.
    for component in range(2):
        mean = _quotient((q if component else p) << DIRECTION_BITS, norm)
        source_value = source_q if component else source_p
        value, steps = code_value(
            coder,
            RESIDUAL_DIRECTION,
            deviation_context,
            magnitude_context_of(residual_magnitude),
            mean,
            source_value,
            shift,
            absolute,
        )
        residual_magnitude = update_magnitude(residual_magnitude, steps)
        max_component = UNIT - abs(x) if absolute else np.int64(UNIT)
        value = min(max(value, -max_component), max_component)
        if component:
            y = value
        else:
            x = value
    if not absolute:
        x, y = (x + y) >> 1, (x - y) >> 1
    quantised_axis[first], quantised_axis[second] = x, y
    quantised_axis[pole] = max(UNIT - abs(x) - abs(y), 0)
    sign = -1 if absolute and quantised_axis[largest_of(quantised_axis)] < 0 else 1
    for a in range(3):
        row[AXIS + a] = sign * quantised_axis[a]
    return residual_magnitude
