"""Tables of the Gaussian codec, computed with integers so that they are identical on every machine."""

import functools
import math

import numpy as np

from splatwire.codec.gaussians.layout import BITS, MAX_COMPANDED
from splatwire.entropy.tables import frozen_table

_POWER_BITS = 120
_LN2 = 818323753292969962226
"""Natural logarithm of 2, times 2**`_LN2_BITS`; a test checks the value."""
_LN2_BITS = 70


@functools.cache
def negative_powers() -> tuple[int, ...]:
    """Returns the table of `2**(-i / 2**BITS)` for i below `2**BITS`, in units of 2**-62."""
    step = 1 << (_POWER_BITS - 1)
    for _ in range(BITS):
        step = math.isqrt(step << _POWER_BITS)
    value, powers = 1 << _POWER_BITS, []
    for _ in range(1 << BITS):
        powers.append(value >> (_POWER_BITS - 62))
        value = value * step >> _POWER_BITS
    return tuple(powers)


@functools.cache
def flatness_table() -> np.ndarray:
    """Returns the table for decoding the ratio of two scales of a Gaussian, which is coded with non-uniform steps.

    Returns:
        log2 of the ratio for each coded integer, in fixed point, int64 (MAX_COMPANDED + 1).
    """
    # A ratio `2**r` is coded as `t = (1 - 2**-r) / ln 2`, so that large ratios are coarser.
    powers, entries, r = negative_powers(), [], 0
    for t in range(MAX_COMPANDED + 1):
        left = (1 << 62) - (t * _LN2 >> (_LN2_BITS + BITS - 62))
        while powers[r & ((1 << BITS) - 1)] >> (r >> BITS) > left:
            r += 1
        entries.append(r)
    return frozen_table(entries)


@functools.cache
def exponentials() -> np.ndarray:
    """Returns a table of powers of two: entry i is `2**(i / 2**BITS)`, float64 in [1, 2), for i below `2**BITS`."""
    powers = np.array(negative_powers(), dtype=np.float64)
    return np.concatenate([[1.0], 2 * powers[:0:-1] * 2.0**-62])
