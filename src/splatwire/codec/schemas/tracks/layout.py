"""Numbers that encoder and decoder of motion share: channels, states, contexts."""

import numpy as np

CHANNELS = ("x", "y", "z", "rx", "ry", "rz", "scale0", "scale1", "scale2", "opacity", "luma", "orange", "green")
"""What can move of a track: place (half lattice units), rotation (vector of four times the tangent of a quarter of the
angle, out of 2**14), logarithms of scales by falling size and of opacity, Y Co Cg (out of 2**12)."""
NUM_CHANNELS = 13
KINDS = ("place", "rotation", "scale", "opacity", "colour")
"""Channels with contexts and a number of coefficients of their own."""
KIND_OF = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4], dtype=np.int64)
NUM_KINDS = 5

TRACK, STATE, BEGINS, ENDS, BEFORE, AFTER = np.arange(6)
HEAD = 6
"""Columns of a decoded element of motion: number of the track, state, first frame in the group, first frame after it,
tracks just before and (only of a group's last one) just after it that are gone."""
STILL, MOVING = 0, 1

MAX_GROUP_FRAMES = 64
MAX_CANDIDATES = 4096
"""Tracks that a packet speaks of: neighbours are searched among all of them."""
CANDIDATE_BITS, TRACK_BITS = np.int64(13), np.int64(28)

NUM_NEIGHBOURS = 8
WEIGHT_BITS = 12
PLACE_BITS = 20
"""Places of a packet's tracks have so many bits while neighbours are searched."""
MAX_COEFFICIENT = 1 << 36
MAX_QUANTISED = (1 << 30) - 1

ORDERS, LEVELS, MAGNITUDES = 8, 10, 16
"""Contexts of a coefficient: its order, how large those next to it were; and of its octave."""
MAX_OCTAVE = 29
C_GONE, C_MOVING, C_ENDS, C_BEGINS = 0, 2, 6, 7
C_ZERO = 8
C_OCTAVE = C_ZERO + NUM_KINDS * ORDERS * LEVELS
NUM_CONTEXTS = C_OCTAVE + NUM_KINDS * LEVELS * MAGNITUDES
"""Adaptive models of bits."""
