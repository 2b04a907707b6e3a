"""Fixed-point formats of the coding path: fractional bits of each kind of integer (docs/determinism.md)."""

UNIT_BITS = 44
"""Fractional bits of positions inside the grid's box, [0, 1]."""

CELL_BITS = 12
"""Fractional bits of positions inside a grid cell."""

ACTIVATION_BITS = 14
"""Fractional bits of network inputs and hidden units, including grid features."""

OUTPUT_BITS = 16
"""Fractional bits of network outputs and decoded features."""

FACTOR_BITS = 16
"""Fractional bits of the factor `1 + tanh(q)` of a quantisation step."""

INVERSE_STEP_BITS = 16
"""Fractional bits of reciprocals of quantisation steps."""

STEP_CELLS = 1024
"""Entries of the step table per unit of q."""

STEP_LIMIT = 4
"""Range of the step table: q from -4 to 4; the factor is clipped beyond."""

ACTIVATION_LIMIT = 1 << 24
"""Activations are clipped to +-1024 units, which keeps all products of layers in the exact range of float64."""

OUTPUT_LIMIT = 1 << 26
"""Network outputs are clipped to +-1024 units."""

EXACT_LIMIT = float(1 << 53)
"""Bound of every partial sum of a matrix product; below it, a float64 product is exact in any order of summation."""

WEIGHT_EXPONENT = 16
"""Weights are integer multiples of 2**-16."""
