"""Fixed-point formats of the coding path: fractional bits of each kind of integer (docs/determinism.md)."""

UNIT_BITS = 44
"""Position inside the grid's box, [0, 1]."""

CELL_BITS = 12
"""Position inside a grid cell."""

ACTIVATION_BITS = 14
"""Inputs and hidden units of the networks, grid features included."""

OUTPUT_BITS = 16
"""Outputs of the networks, decoded features."""

FACTOR_BITS = 16
"""The factor `1 + tanh(q)` of a quantisation step."""

INVERSE_STEP_BITS = 16
"""Reciprocals of quantisation steps."""

STEP_CELLS = 1024
"""Entries of the step table per unit of q."""

STEP_LIMIT = 4
"""The step table covers q from -4 to 4; beyond, the factor is clipped."""

ACTIVATION_LIMIT = 1 << 24
"""Activations are clipped to +-1024 units, so that no product of layers can leave the exact range."""

OUTPUT_LIMIT = 1 << 26
"""Network outputs are clipped to +-1024 units."""

EXACT_LIMIT = float(1 << 53)
"""Every partial sum of a matrix product stays below this, so a float64 product is exact in any order."""

WEIGHT_EXPONENT = 16
"""Weights are whole multiples of 2**-16."""
