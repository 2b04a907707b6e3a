"""Numba kernels that fit motion coefficients to trajectories."""

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.ops.compiled import njit

# Multiplies vectors of length tan(angle / 4); coded vectors have the length 4 tan(angle / 4). The value in
# `trajectories`, which divides coded vectors, lacks the factor 4.
_ROTATION_UNITS, _FIXED_POINT_ONE = 4.0 * (1 << DIRECTION_BITS), 1.0 * (1 << BITS)
_ZERO, _ONE = np.float64(0.0), np.float64(1.0)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _relative_rotations(quats, keyframe_quat, begin, end, last_rotation, largest, values):
    """Computes the rotation of one track (a Gaussian over time) relative to its keyframe Gaussian, in each frame.

    The frames `begin` to `end - 1` of a group of F frames are added; earlier calls have added the frames before.

    Args:
        quats: Orientation of the track in each frame of the group, as quaternions, (F, 4).
        keyframe_quat: Orientation of the keyframe Gaussian, as a quaternion, (4).
        begin: First frame to add.
        end: End of the frames to add (exclusive).
        last_rotation: Relative rotation in the frame before `begin`, as a unit quaternion, (4). Replaced by the
            relative rotation in frame `end - 1`.
        largest: tan(angle / 4) of the largest relative rotation in the frames before `begin`.
        values: Motion of the track, (channels, F). Rows 3 to 5 of the added frames are overwritten with rotation
            vectors in fixed point, of length proportional to tan(angle / 4).

    Returns:
        tan(angle / 4) of the largest relative rotation in the frames before `end`.
    """
    length, b0, b1, b2, b3 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    # The sign of each quaternion is chosen so that the rotation continues that of the preceding frame.
    for f in range(begin, end):
        same = last_rotation[0] == _ONE and last_rotation[1] == 0 and last_rotation[2] == 0 and last_rotation[3] == 0
        for a in range(4):
            same &= quats[f, a] == keyframe_quat[a]
        if same:
            values[3, f], values[4, f], values[5, f] = _ZERO, _ZERO, _ZERO
            continue
        if length == 0:
            for a in range(4):
                length += np.float64(keyframe_quat[a]) * np.float64(keyframe_quat[a])
            length = np.sqrt(length)
            b0, b1, b2, b3 = (
                keyframe_quat[0] / length,
                keyframe_quat[1] / length,
                keyframe_quat[2] / length,
                keyframe_quat[3] / length,
            )
        q0, q1, q2, q3 = (
            np.float64(quats[f, 0]),
            np.float64(quats[f, 1]),
            np.float64(quats[f, 2]),
            np.float64(quats[f, 3]),
        )
        norm = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        q0, q1, q2, q3 = q0 / norm, q1 / norm, q2 / norm, q3 / norm
        w = q0 * b0 + q1 * b1 + q2 * b2 + q3 * b3
        x = b0 * q1 - q0 * b1 - (q2 * b3 - q3 * b2)
        y = b0 * q2 - q0 * b2 - (q3 * b1 - q1 * b3)
        z = b0 * q3 - q0 * b3 - (q1 * b2 - q2 * b1)
        if w * last_rotation[0] + x * last_rotation[1] + y * last_rotation[2] + z * last_rotation[3] < 0:
            w, x, y, z = -w, -x, -y, -z
        last_rotation[0], last_rotation[1], last_rotation[2], last_rotation[3] = w, x, y, z
        denominator = max(_ONE + w, 1e-3)
        x, y, z = x / denominator, y / denominator, z / denominator
        largest = max(largest, np.sqrt(x * x + y * y + z * z))
        values[3, f], values[4, f], values[5, f] = x * _ROTATION_UNITS, y * _ROTATION_UNITS, z * _ROTATION_UNITS
    return largest


@njit(borrows=True, error_model="numpy")
@no_type_check
def _log_scale_changes(scales, opacities, keyframe_scales, opacity, begin, end, values):
    """Computes how the scales and the opacity of one track (a Gaussian over time) change in each frame.

    A change is log2 of the ratio to the value of the track's keyframe Gaussian. The frames `begin` to `end - 1` of a
    group of F frames are added.

    Args:
        scales: Scales of the track in each frame of the group, (F, 3).
        opacities: Opacity of the track in each frame of the group, (F).
        keyframe_scales: Scales of the keyframe Gaussian, (3).
        opacity: Opacity of the keyframe Gaussian.
        begin: First frame to add.
        end: End of the frames to add (exclusive).
        values: Motion of the track, (channels, F). Rows 6 to 9 of the added frames are overwritten with the changes of
            the three scales (largest scale of the keyframe Gaussian first) and of the opacity, in fixed point.
    """
    # Equal values give exactly 0 without computing a logarithm.
    # Axes are sorted by decreasing scale of the keyframe Gaussian.
    for rank in range(3):
        axis_of_rank = 0
        for axis in range(3):  # rank of an axis: number of larger scales, plus equal ones with a smaller index
            before = 0
            for other in range(3):
                before += keyframe_scales[other] > keyframe_scales[axis] or (
                    keyframe_scales[other] == keyframe_scales[axis] and other < axis
                )
            if before == rank:
                axis_of_rank = axis
        for f in range(begin, end):
            same = scales[f, axis_of_rank] == keyframe_scales[axis_of_rank]
            values[6 + rank, f] = (
                _ZERO
                if same
                else (np.log2(np.float64(scales[f, axis_of_rank])) - np.log2(np.float64(keyframe_scales[axis_of_rank])))
                * _FIXED_POINT_ONE
            )
    for f in range(begin, end):
        same = opacities[f] == opacity
        values[9, f] = (
            _ZERO if same else (np.log2(np.float64(opacities[f])) - np.log2(np.float64(opacity))) * _FIXED_POINT_ONE
        )


@njit(borrows=True, error_model="numpy")
@no_type_check
def _project(values, basis, begin, end, coefficients):
    """Adds a range of frames to the fit of a track's motion: projects the motion onto the basis polynomials.

    Args:
        values: Motion of the track in each frame, by channel, (channels, F).
        basis: Basis polynomials, float64 (F, F).
        begin: First frame.
        end: End of the frames (exclusive).
        coefficients: Polynomial coefficients of the track, changed in place.
    """
    for c in range(NUM_CHANNELS):
        for f in range(begin, end):
            value = values[c, f]
            if value != 0:
                for k in range(len(basis)):
                    coefficients[c, k] += value * basis[f, k]


@njit(nogil=True, error_model="numpy")
@no_type_check
def fit_motion(
    trajectories,
    keyframes,
    keyframe_indices,
    world_to_units,
    to_luma_chroma,
    basis,
    begin,
    end,
    coefficients,
    largest,
    largest_rotation,
    last_rotation,
):
    """Fits polynomials over time to the motion of n tracks (Gaussians over time), before quantisation.

    Each call adds the contribution of a range of frames, in ascending order.

    Args:
        trajectories: Trajectories of n tracks: means, quaternions, scales, opacities and colours, float32 (n, F, ...).
        keyframes: T keyframe Gaussians: means, quaternions, scales, opacities and colours, float32 (T, 1, ...).
        keyframe_indices: Index in `keyframes` of each track's keyframe Gaussian, int64 (n); tracks with a negative
            index are skipped.
        world_to_units: Factor from world units to units of motion.
        to_luma_chroma: Matrix from colours to Y Co Cg, float64 (3, 3).
        basis: Basis polynomials, float64 (F, F).
        begin: First frame of this call.
        end: End of the frames of this call (exclusive).
        coefficients: Polynomial coefficients, float64 (n, channels, frames), zero before the first call; changed in
            place.
        largest: Output: largest magnitude of each channel's coefficients, float64 (n, channels), written with the last
            frame.
        largest_rotation: tan(angle / 4) of the largest rotation of each track so far, relative to its keyframe
            Gaussian, float64 (n); zero before the first call, changed in place.
        last_rotation: Rotation of each track in the last added frame, as a quaternion, float64 (n, 4); the identity
            before the first call, changed in place.
    """
    means, quats, scales, opacities, colours = trajectories
    m, q, s, o, c = keyframes
    values = np.empty((NUM_CHANNELS, len(basis)))
    for i in range(len(keyframe_indices)):
        j = keyframe_indices[i]
        if j < 0:
            continue
        for f in range(begin, end):
            for a in range(3):
                values[a, f] = (np.float64(means[i, f, a]) - np.float64(m[j, 0, a])) * world_to_units
                total = _ZERO
                for b in range(3):
                    total += (np.float64(colours[i, f, b]) - np.float64(c[j, 0, b])) * to_luma_chroma[a, b]
                values[10 + a, f] = total
        largest_rotation[i] = _relative_rotations(
            quats[i], q[j, 0], begin, end, last_rotation[i], largest_rotation[i], values
        )
        _log_scale_changes(scales[i], opacities[i], s[j, 0], o[j, 0], begin, end, values)
        _project(values, basis, begin, end, coefficients[i])
        if end < len(basis):
            continue
        for channel in range(NUM_CHANNELS):
            max_magnitude = _ZERO
            for k in range(len(basis)):
                max_magnitude = max(max_magnitude, abs(coefficients[i, channel, k]))
            largest[i, channel] = max_magnitude


@njit(nogil=True, error_model="numpy")
@no_type_check
def find_moving(largest, rotations, shifts, track_indices, limits, too_far, moving):
    """Finds which of n tracks (Gaussians over time) move in a group of frames, and which move too far.

    A track that moves too far cannot be coded relative to its keyframe Gaussian, and needs a new keyframe Gaussian. A
    track moves if one of its coefficients is large enough to be coded.

    Args:
        largest: Largest absolute motion coefficient of each track in each channel, in the units of `layout.CHANNELS`,
            float64 (n, channels).
        rotations: tan(angle / 4) of the largest rotation of each track relative to its keyframe Gaussian, float64 (n).
        shifts: log2 of the quantisation step of each channel's motion, for all T tracks, int64 (T, channels).
        track_indices: Row in `shifts` of each of the n tracks, int64 (n).
        limits: Thresholds, float64 (4), from `fitting.MOTION_LIMITS`.
        too_far: Output: mask of tracks that move too far, bool (n).
        moving: Output: mask of tracks that move, bool (n).
    """
    for i in range(len(track_indices)):
        track_shifts, is_too_far, is_moving = shifts[track_indices[i]], rotations[i] > limits[2], False
        for c in range(NUM_CHANNELS):
            step, largest_change = np.float64(np.int64(1) << track_shifts[c]), largest[i, c]
            is_too_far = is_too_far or largest_change > limits[0] * step or largest_change > limits[1]
            is_moving = is_moving or largest_change >= limits[3] * step
        too_far[i], moving[i] = is_too_far, is_moving
