"""Numba kernel that computes the motion of tracks (Gaussians over time) in one frame."""

from typing import no_type_check

import numpy as np

from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.ops.compiled import njit

_FIRST_COLOUR = NUM_CHANNELS - 3


@njit(nogil=True, error_model="numpy")
@no_type_check
def offsets(coefficients, starts, packets, num_coefficients, widths, basis_values, factors, to_rgb, out):
    """Evaluates the motion polynomials of n tracks (Gaussians over time) in one frame of a group of F frames.

    The change of a channel is the sum of its coefficients, each multiplied by a basis polynomial. There are F
    polynomials, with degrees 0 to F - 1.

    Args:
        coefficients: Coefficients of the moving tracks of all packets in one flat array, float32. A track has
            `widths[packet]` coefficients for its first channel, then as many for the next channel, and so on.
        starts: Index in `coefficients` of each track's first coefficient, int64 (n); -1 for a track that does not move.
        packets: Index of the packet that contains each track, int64 (n); any index for a track that does not move.
        num_coefficients: For each packet and channel, number of coefficients to use; the others are 0, int64 (packets,
            channels).
        widths: For each packet, number of coefficients per channel in `coefficients`, int64 (packets).
        basis_values: Value of each basis polynomial in this frame, float64 (F).
        factors: For each channel, factor from its fixed-point unit to floating point, float64 (channels).
        to_rgb: Matrix from Y Co Cg to red, green, blue, float64 (3, 3).
        out: Output: change of each track relative to its keyframe Gaussian, float32 (n, channels); 0 for a track that
            does not move.
    """
    values = np.zeros(NUM_CHANNELS)
    # `tests/reference/trajectories.py` is an equivalent implementation in plain Python.
    for n in range(len(starts)):
        if starts[n] < 0:
            for c in range(NUM_CHANNELS):
                out[n, c] = 0.0
            continue
        packet = packets[n]
        width = widths[packet]
        for c in range(NUM_CHANNELS):
            begin, value = starts[n] + c * width, np.float64(0.0)
            for k in range(num_coefficients[packet, c]):
                value += coefficients[begin + k] * basis_values[k]
            values[c] = value * factors[c]
        for c in range(_FIRST_COLOUR):
            out[n, c] = values[c]
        for a in range(3):
            value = np.float64(0.0)
            for c in range(3):
                value += values[_FIRST_COLOUR + c] * to_rgb[c, a]
            out[n, _FIRST_COLOUR + a] = value
