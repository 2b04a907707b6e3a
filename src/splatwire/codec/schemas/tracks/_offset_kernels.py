"""Numba kernel that turns coefficients into offsets of a frame; `tests/reference/trajectories.py` says it plainly."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS
from splatwire.ops.compiled import njit

_COLOURS = NUM_CHANNELS - 3


@njit(nogil=True, error_model="numpy")
@no_type_check
def offsets(coefficients, starts, packets, orders, widths, weights, factors, colours, found):
    """Offsets of tracks in one frame.

    Args:
        coefficients: Those of all packets, one after another, float32.
        starts: Where those of each track begin, int64 (n); -1 of one that stands still.
        packets: Packet of each, int64 (n).
        orders: How many there are of each channel in a packet, int64 (packets, C).
        widths: How many places a channel takes in a packet, int64 (packets).
        weights: Of each order in this frame, float64 (F).
        factors: Units of the channels, float64 (C).
        colours: From luma and chroma to red, green, blue, float64 (3, 3).
        found: Where they go, float32 (n, C).
    """
    values = np.zeros(NUM_CHANNELS)
    for n in range(len(starts)):
        if starts[n] < 0:
            for c in range(NUM_CHANNELS):
                found[n, c] = 0.0
            continue
        packet = packets[n]
        width = widths[packet]
        for c in range(NUM_CHANNELS):
            begin, value = starts[n] + c * width, np.float64(0.0)
            for k in range(orders[packet, c]):
                value += coefficients[begin + k] * weights[k]
            values[c] = value * factors[c]
        for c in range(_COLOURS):
            found[n, c] = values[c]
        for a in range(3):
            value = np.float64(0.0)
            for c in range(3):
                value += values[_COLOURS + c] * colours[c, a]
            found[n, _COLOURS + a] = value
