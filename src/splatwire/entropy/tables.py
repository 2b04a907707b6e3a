"""Integer tables of the entropy coder, identical on every machine."""
# The tables are computed with the decimal module (software arithmetic, correctly rounded). The machine's floating-point
# library could differ in one entry, which would corrupt every packet (docs/determinism.md).

import decimal
import functools

import numpy as np

TOTAL_BITS = 24
"""Fractional bits of probabilities: integers out of 2**24."""

MEAN_BITS = 12
"""Fractional bits of means and boundaries, which are in quantisation steps."""

SCALE_STEPS = 16
"""Entries of the scale table per octave. Neighbours differ by at most 1/16, so the nearest entry is within about 3 % of
a scale.
"""

SCALE_MIN_EXPONENT = -6
SCALE_MAX_EXPONENT = 14
NUM_SCALES = (SCALE_MAX_EXPONENT - SCALE_MIN_EXPONENT) * SCALE_STEPS

INVERSE_BITS = 20
"""Fractional bits of the reciprocal scales."""

Z_BITS = 16
"""Fractional bits of the standardised boundary."""

Z_CELL_BITS = 9
"""Fractional bits within a cell of the normal table: a cell spans 2**9 / 2**16 = 1/128 standard deviations."""

Z_LIMIT = 6
"""Range of the normal table, standard deviations: -6 to 6. The tail falls below 2**-24 at 5.3."""

NUM_LOGITS = 256
"""Entries of the table of the logistic function: logits from -8 up to, not including, 8 in steps of 1/16."""


@functools.cache
def normal_table() -> np.ndarray:
    """Returns the standard normal CDF at multiples of 1/128 from -6 to 6, in units of 2**-24.

    Returns:
        int64 of length `2 * 6 * 128 + 1`, increasing from 0 to 2**24.
    """
    cells = Z_LIMIT << (Z_BITS - Z_CELL_BITS)
    with decimal.localcontext() as context:
        context.prec = 50
        norm = 1 / (2 * _pi()).sqrt()
        upper = [_half_plus_integral(decimal.Decimal(i) / (cells // Z_LIMIT), norm) for i in range(cells + 1)]
        scaled = [int((p * (1 << TOTAL_BITS)).to_integral_value(decimal.ROUND_HALF_EVEN)) for p in upper]
    scaled[-1] = 1 << TOTAL_BITS
    lower = [(1 << TOTAL_BITS) - v for v in reversed(scaled[1:])]
    return frozen_table(lower + scaled)


def _half_plus_integral(z: decimal.Decimal, norm: decimal.Decimal) -> decimal.Decimal:
    """Returns the CDF of the standard normal distribution at z >= 0, computed by a series; `norm` is 1 / sqrt(2 pi)."""
    # The series is `1/2 + norm * exp(-z^2 / 2) * (z + z^3/3 + z^5/15 + ...)`, where `norm` is `1 / sqrt(2 pi)`.
    term = total = z
    square, k = z * z, 1
    while term > decimal.Decimal("1e-20"):
        k += 2
        term = term * square / k
        total += term
    return decimal.Decimal("0.5") + norm * (-square / 2).exp() * total


def _pi() -> decimal.Decimal:
    """Pi by Machin's formula, to the precision of the current decimal context."""

    def arctan_inverse(n: int) -> decimal.Decimal:
        power = decimal.Decimal(1) / n
        total, k, sign = power, 1, 1
        while power > decimal.Decimal("1e-48"):
            power /= n * n
            k, sign = k + 2, -sign
            total += sign * power / k
        return total

    return 16 * arctan_inverse(5) - 4 * arctan_inverse(239)


@functools.cache
def inverse_scale_table() -> np.ndarray:
    """Returns the reciprocals of the standard deviations that the entropy coder can use, in fixed point.

    Returns:
        int64 of length `NUM_SCALES`, decreasing, with `INVERSE_BITS` fractional bits.
    """
    # Entry `16 e + m` is the reciprocal of `2**(e - 6) * (1 + (m + 1/2) / 16)` quantisation steps.
    entries = []
    for index in range(NUM_SCALES):
        exponent, mantissa = divmod(index, SCALE_STEPS)
        # 1 / (2**(e-6) * (2*16 + 2m + 1) / 32), rounded to the nearest integer
        numerator = 2 * SCALE_STEPS << (INVERSE_BITS - SCALE_MIN_EXPONENT)
        denominator = (2 * SCALE_STEPS + 2 * mantissa + 1) << exponent
        entries.append((2 * numerator + denominator) // (2 * denominator))
    return frozen_table(entries)


@functools.cache
def half_width_table() -> np.ndarray:
    """Returns, for each standard deviation, the largest distance from the mean that is coded without an escape code.

    Returns:
        int64 of length `NUM_SCALES`, in quantisation steps.
    """
    inverse = inverse_scale_table()
    return frozen_table([min(8191, ((10 << INVERSE_BITS) // int(v)) + 16) for v in inverse])


@functools.cache
def logistic_table() -> np.ndarray:
    """Tabulates the logistic function, which converts a logit to a probability or to a mixture's first weight.

    Entry i is the value, in units of 2**-16, for the logit `i / 16 - 8`.

    Returns:
        int64 of length `NUM_LOGITS`.
    """
    return frozen_table([_logistic_integer(decimal.Decimal(i - NUM_LOGITS // 2) / 16, 16) for i in range(NUM_LOGITS)])


@functools.cache
def step_table(cells_per_unit: int, limit: int, bits: int) -> np.ndarray:
    """Tabulates `1 + tanh(q)`, by which HAC++ multiplies the quantisation steps of an anchor; q is a network output.

    Args:
        cells_per_unit: Table entries per unit of q.
        limit: Range of q: from -limit to limit.
        bits: Fractional bits of the entries.

    Returns:
        int64 of length `2 * limit * cells_per_unit + 1`.
    """
    half = limit * cells_per_unit
    return frozen_table(
        [2 * _logistic_integer(decimal.Decimal(2 * i) / cells_per_unit, bits) for i in range(-half, half + 1)]
    )


@functools.cache
def exp2_table(cell_bits: int, bits: int) -> np.ndarray:
    """Returns a table of powers of two: entry i is `2**(i / 2**cell_bits)`, with `bits` fractional bits.

    Returns:
        int64 of length `2**cell_bits + 1`.
    """
    with decimal.localcontext() as context:
        context.prec = 40
        root = (decimal.Decimal(2).ln() / (1 << cell_bits)).exp()
        values, value = [], decimal.Decimal(1 << bits)
        for _ in range((1 << cell_bits) + 1):
            values.append(int(value.to_integral_value(decimal.ROUND_HALF_EVEN)))
            value *= root
    return frozen_table(values)


def _logistic_integer(x: decimal.Decimal, bits: int) -> int:
    with decimal.localcontext() as context:
        context.prec = 30
        value = (1 << bits) / (1 + (-x).exp())
        return int(value.to_integral_value(decimal.ROUND_HALF_EVEN))


def frozen_table(values: list[int]) -> np.ndarray:
    """Returns integers as a read-only int64 array."""
    table = np.array(values, dtype=np.int64)
    table.setflags(write=False)
    return table
