"""Constants of the Gaussian codec: fixed-point formats, decoded integers, contexts, and quantisation steps."""

import numpy as np

BITS = 12
"""Fractional bits of base-2 logarithms, colours and spherical harmonics."""
DIRECTION_BITS = 14
"""Fractional bits of principal axes, and of their coordinates on the octahedral square."""
STEP_BITS = 6
"""Fractional bits of the base-2 exponents of quantisation steps, in the side information and in `COEFFICIENTS`."""

# Column, kind and step indices are numpy integers, because numba compiles a function once per literal argument.
POSITION, CLASS, OPACITY, SCALE0, ELONGATION, FLATNESS, AXIS, PRIMARY, SPIN_BITS, SPIN, LUMA = np.array(
    [0, 3, 4, 5, 6, 7, 8, 11, 12, 13, 14]
)
COLUMNS = 17
"""Number of integers of a decoded Gaussian, without harmonics. The columns are, in order:

* `POSITION` (3): position relative to the lower corner of the block's bounding box (in `_rounding_kernels`: to the
  origin of the lattice), in half lattice spacings
* `CLASS`: precision class
* `OPACITY`: logarithm of the opacity
* `SCALE0`: logarithm of the largest scale
* `ELONGATION`: logarithm of the ratio of the largest to the second scale
* `FLATNESS`: ratio of the second to the third scale, companded (see `MAX_COMPANDED`)
* `AXIS` (3): primary axis
* `PRIMARY`: index of the primary axis, 0 for the axis of the largest scale, 2 for that of the smallest
* `SPIN_BITS`, `SPIN`: rotation about the primary axis, as number of bits and value
* `LUMA` (3): Y Co Cg (orthonormal; see `attributes.LUMA_CHROMA`)
"""

RESIDUAL_KINDS = ("opacity", "scale0", "elongation", "flatness", "direction", "luma", "orange", "green")
"""Kinds of prediction residuals; each kind has separate context tables."""
(
    RESIDUAL_OPACITY,
    RESIDUAL_SCALE0,
    RESIDUAL_ELONGATION,
    RESIDUAL_FLATNESS,
    RESIDUAL_DIRECTION,
    RESIDUAL_LUMA,
) = np.arange(6)
NUM_DEVIATION_CONTEXTS, NUM_MAGNITUDE_CONTEXTS = 12, 16
"""Number of contexts of a residual: by the deviation of the neighbours from their mean
(`NUM_DEVIATION_CONTEXTS`), and by log2 of either the quantisation step or the preceding residuals of the Gaussian
(`NUM_MAGNITUDE_CONTEXTS`).
"""

STEPS = ("opacity", "scale0", "elongation", "flatness", "position", "direction", "spin", "colour", "harmonics")
"""Names of the quantities with a separate quantisation step, in the order of the side information. The first four are
those of `RESIDUAL_KINDS`, in the same order: `_gaussian_kernels.code_logs` uses one index for both.
"""
(
    STEP_OPACITY,
    STEP_SCALE0,
    STEP_ELONGATION,
    STEP_FLATNESS,
    STEP_POSITION,
    STEP_DIRECTION,
    STEP_SPIN,
    STEP_COLOUR,
    STEP_HARMONICS,
) = np.arange(9)

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
"""Dependence of quantisation steps on decoded scales and opacity. When a column grows by 1 octave, the step of each
quantity in `STEPS` (one per row) becomes finer by this number of 64ths of an octave; int64 (steps, 4).
"""

MAX_CLASSES = 8
POSITION_CONTEXTS = 32
CLASS_CONTEXTS = 18 * MAX_CLASSES
HARMONIC_CONTEXTS = MAX_CLASSES + 64 + 24
FIRST_CLASS = POSITION_CONTEXTS
"""Index of the first model of precision classes in the array of adaptive bit models."""
FIRST_HARMONIC = FIRST_CLASS + CLASS_CONTEXTS
"""Index of the first model of harmonics in the array of adaptive bit models."""
FIRST_MAGNITUDE = FIRST_HARMONIC + MAX_CLASSES + 64
"""Index of the first model of magnitudes of nonzero harmonics in the array of adaptive bit models."""
NUM_CONTEXTS = FIRST_HARMONIC + HARMONIC_CONTEXTS
"""Number of adaptive bit models: for the division of grid cells, the precision classes and the harmonics."""

NUM_NEIGHBOURS = 6
WINDOW = 64
"""Number of preceding Gaussians of a packet among which neighbours are searched."""
MAX_SQUARED_DISTANCE = 1 << 40
"""Upper limit of the squared distance of a neighbour, so that its product with 2**12 is exact in a float64."""

MAX_LOG = 40 << BITS
MAX_LOG_OPACITY = -1
"""Largest stored logarithm of an opacity: just below log2(1) = 0. Encoders round it like 0."""
MIN_LOG_OPACITY = -(10 << BITS)
ASSUMED_ELONGATION = 2 << BITS
"""Ratio of the two largest scales that the step of this ratio assumes, because it is not known yet: 2 octaves."""
MAX_COLOUR = 1 << (BITS + 8)
MAX_HARMONIC = 1 << 24
TRANSFORM_UNIT = 127
"""Denominator of the transform of spherical harmonics, which is stored as integers."""
MAX_RESIDUAL = 1 << 24
MAX_COMPANDED = 5903
"""Largest companded ratio of the second to the third scale, `(1 - 2**-r) / ln 2` for r = 10 (a ratio of 2**10), in
fixed point.
"""
MAX_FLATNESS = 10
"""log2 of the largest ratio of the second to the third scale that the format represents."""

WIDE_SCALE_OFFSET = 24
"""Offset in the scale table between the two normals of a residual's mixture distribution, which approximates a
Laplacian.
"""
NARROW_WEIGHT = 45875
"""Weight of the narrower normal in the mixture, out of 2**16."""
SCALE_INDEX_STEP = 4
"""Distance between two indices of standard deviations that the side information can express."""

MEAN_FRACTION_BITS = np.int64(3)
"""Number of fractional bits of a predicted mean in quantisation steps: means are rounded to eighths of a step."""

SLOT_BITS = 8
"""Number of lowest bits of a cell's Morton code that form its slot. Cells with equal slots are spread evenly over a
block, which is the basis for packets that each cover the whole block.
"""
MAX_LATTICE_BITS = 40
MAX_CELL_BITS = 21
"""Maximum number of bits per axis of a cell in the coarse grid. An encoder chooses the cell size once per block."""
