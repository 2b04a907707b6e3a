"""Constants of the motion codec: channels of motion, packet headers, and contexts of the entropy coder."""

import numpy as np

CHANNELS = ("x", "y", "z", "rx", "ry", "rz", "scale0", "scale1", "scale2", "opacity", "luma", "orange", "green")
"""Channels of motion: position (in units of motion); rotation (vector of length four times the tangent of a quarter of
the angle, in fixed point with 14 fractional bits); logarithms of the scales in decreasing order, and of the opacity;
base colour as Y Co Cg (12 fractional bits).
"""
NUM_CHANNELS = 13
KINDS = ("position", "rotation", "scale", "opacity", "colour")
"""Kinds of channels. Each kind has separate contexts, and a packet codes the same number of coefficients for all
channels of a kind.
"""
KIND_OF = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4], dtype=np.int64)
NUM_KINDS = 5

TRACK, STATE, BEGINS, ENDS, GAP_BEFORE, GAP_AFTER = np.arange(6)
HEADER_FIELDS = 6
"""Number of integers in the header of a track in a motion packet: track number; state (`STILL` or `MOVING`); first
frame, relative to the group; end frame (first frame without the track); number of absent track numbers just before this
track; and, only for the last track of a group, number of absent track numbers just after it.
"""
STILL, MOVING = 0, 1

MAX_GROUP_FRAMES = 64
MAX_TRACK_SPAN = 4096
"""Maximum range of track numbers in a packet (last minus first plus one), which limits the time to search for
neighbours.
"""
SPAN_BITS, TRACK_BITS = np.int64(13), np.int64(28)
"""Number of bits of the range of track numbers, and of the first track number, in a packet."""

NUM_NEIGHBOURS = 8
WEIGHT_BITS = 12
POSITION_BITS = 20
"""Number of bits per axis of a position in the search for neighbours."""
MAX_LOG2_RATIO = 20
"""Largest ratio of the lattice spacing of a shot to that of the first shot, octaves in either direction."""
MAX_COORD = 1 << 50
"""Largest coordinate of a keyframe Gaussian in the unit of motion; larger ones are clipped."""
MAX_COEFFICIENT = 1 << 36
MAX_QUANTISED = (1 << 30) - 1

DEGREE_CONTEXTS = 8
"""Number of contexts of a coefficient's zero flag, selected by the coefficient's degree."""
NEIGHBOUR_CONTEXTS = 10
"""Number of contexts of a coefficient, selected by the octave of neighbouring coefficients' magnitude."""
OCTAVE_CONTEXTS = 16
"""Number of contexts for the bits of a coefficient's octave, selected by the position of the bit."""
MAX_OCTAVE = 29
C_ABSENT, C_MOVING, C_ENDS, C_BEGINS = 0, 2, 6, 7
"""First context of each flag of a header: absent track number (2 contexts, by the same flag of the previous number),
state (4, by the states of the previous two tracks), end inside the group (1) and begin inside the group (1).
"""
C_ZERO = 8
"""First context of the zero flags of coefficients, by kind, degree and neighbours."""
C_OCTAVE = C_ZERO + NUM_KINDS * DEGREE_CONTEXTS * NEIGHBOUR_CONTEXTS
"""First context of the octaves of coefficients, by kind, neighbours and position of the bit."""
NUM_CONTEXTS = C_OCTAVE + NUM_KINDS * NEIGHBOUR_CONTEXTS * OCTAVE_CONTEXTS
"""Number of adaptive bit models of a motion packet."""
