"""Numbers that encoder and decoder share: fixed-point formats, columns of integers, contexts, coefficients of steps."""

import numpy as np

BITS = 12
"""Fractional bits of logarithms to base 2, colours and harmonics."""
DIRECTION_BITS = 14
"""Fractional bits of axes, and of places on the octahedral square."""
STEP_BITS = 6
"""Fractional bits of the exponents of steps in the side information and of `COEFFICIENTS`."""

# Numbers of columns, streams and steps are numpy's: numba compiles a function anew for each literal it is called with.
LATTICE, CLASS, OPACITY, SCALE0, SCALE1, SCALE2, AXIS, PRIMARY, SPIN_BITS, SPIN, LUMA = np.array(
    [0, 3, 4, 5, 6, 7, 8, 11, 12, 13, 14]
)
COLUMNS = 17
"""Columns of a decoded Gaussian: place (3, in half lattice units), class, logarithms of opacity, of the largest
scale and of its ratio to the second, companded ratio of the second to the third, primary axis (3), which one it is
(0 largest, 2 smallest), turn about it (bits, value), Y Co Cg (3)."""

STREAMS = ("opacity", "scale0", "scale1", "scale2", "direction", "luma", "orange", "green")
"""Streams of residuals, each with tables of its own."""
R_OPACITY, R_SCALE0, R_SCALE1, R_SCALE2, R_DIRECTION, R_LUMA = np.arange(6)
SPREADS, SECONDS = 12, 16
"""Contexts of a residual: how much its neighbours differ, and log2 of its step, or of the residuals before it."""

STEPS = ("opacity", "scale0", "scale1", "scale2", "position", "direction", "spin", "colour", "harmonics")
"""What has a step of its own, in the order of the side information."""
S_OPACITY, S_SCALE0, S_SCALE1, S_SCALE2, S_POSITION, S_DIRECTION, S_SPIN, S_COLOUR, S_HARMONICS = np.arange(9)

COEFFICIENTS = np.array(
    [
        # log2 s0 + log2 s1, log2 s0 / s1, log2 s1 / s2, log2 opacity
        [0, 0, 0, 0],
        [16, 0, 0, 13],
        [16, 0, 0, 13],
        [16, -51, 0, 13],
        [-21, -13, 0, 0],
        [16, 102, 70, 16],
        [19, 51, 154, 16],
        [0, 0, 0, 0],
        [0, 0, 0, 0],
    ],
    dtype=np.int64,
)
"""Octaves (out of 64) by which a step is finer for each octave of what is decoded before; `STEPS` by four."""

MAX_CLASSES = 8
POSITION_CONTEXTS = 32
CLASS_CONTEXTS = 18 * MAX_CLASSES
HARMONIC_CONTEXTS = MAX_CLASSES + 64 + 24
FIRST_CLASS = POSITION_CONTEXTS
FIRST_HARMONIC = FIRST_CLASS + CLASS_CONTEXTS
FIRST_MAGNITUDE = FIRST_HARMONIC + MAX_CLASSES + 64
NUM_CONTEXTS = FIRST_HARMONIC + HARMONIC_CONTEXTS
"""Adaptive models of bits: splits of cells, classes, harmonics."""

NUM_NEIGHBOURS = 6
WINDOW = 64
"""Neighbours are the nearest of so many Gaussians before."""
FAR = 1 << 40
"""Squared distances of neighbours end here: they times 2**12 are exact in a float64, too."""

MAX_LOG = 40 << BITS
MAX_OPACITY = -1
MIN_OPACITY = -(10 << BITS)
MAX_COLOUR = 1 << (BITS + 8)
MAX_HARMONIC = 1 << 24
TRANSFORM_UNIT = 127
"""Entries of the transform of harmonics are out of this."""
MAX_RESIDUAL = 1 << 24
MAX_THIN = 5903
"""Largest value of a companded ratio of scales, `(1 - 2**-r) / ln 2`: a ratio of 2**10."""
MAX_THINNESS = 10
"""log2 of that ratio."""

WIDE = 24
"""Entries of the scale table between the two normals of a residual; together they are nearly a Laplacian."""
NARROW_WEIGHT = 45875
"""Weight of the narrow one out of 2**16."""
SCALE_UNIT = 4
"""Scales are sent in units of so many entries of the scale table."""

EIGHTHS = np.int64(3)
"""A mean between two multiples of a step counts in so many fractional bits."""

SLOT_BITS = 8
"""Lowest bits of a cell's Morton code: Gaussians whose codes agree in them are evenly spread over a block."""
MAX_LATTICE_BITS = 40
MAX_CELL_BITS = 21
"""Cells of a packet's first grid are at most so many to a side of its block's box."""
