"""Integer tables of the Gaussians' codec, alike on every machine."""

import functools
import math

import numpy as np

from splatwire.codec.schemas.gaussians.layout import BITS, MAX_THIN

_POWER_BITS = 120
_LN2 = 818323753292969962226
"""ln 2 times 2**`_LN2_BITS`, checked by a test."""
_LN2_BITS = 70


@functools.cache
def negative_powers() -> tuple[int, ...]:
    """`2**(-i / 2**BITS)` for one octave, in units of 2**-62, by square roots of integers."""
    step = 1 << (_POWER_BITS - 1)
    for _ in range(BITS):
        step = math.isqrt(step << _POWER_BITS)
    value, powers = 1 << _POWER_BITS, []
    for _ in range(1 << BITS):
        powers.append(value >> (_POWER_BITS - 62))
        value = value * step >> _POWER_BITS
    return tuple(powers)


@functools.cache
def thinness_table() -> np.ndarray:
    """Logarithm r of a ratio of scales for companded values t = (1 - 2**-r) / ln 2, all with `BITS` fractional bits.

    Returns:
        int64 of length `MAX_THIN + 1`, increasing.
    """
    powers, entries, r = negative_powers(), [], 0
    for t in range(MAX_THIN + 1):
        left = (1 << 62) - (t * _LN2 >> (_LN2_BITS + BITS - 62))
        while powers[r & ((1 << BITS) - 1)] >> (r >> BITS) > left:
            r += 1
        entries.append(r)
    return _frozen(entries)


@functools.cache
def exponentials() -> np.ndarray:
    """`2**(i / 2**BITS)` for one octave, float64 in [1, 2), from integers."""
    powers = np.array(negative_powers(), dtype=np.float64)
    return np.concatenate([[1.0], 2 * powers[:0:-1] * 2.0**-62])


def power_of_two(logs: np.ndarray) -> np.ndarray:
    """`2**(logs / 2**BITS)` of int64 fixed point, float64: exact but for one rounding, alike everywhere."""
    return np.ldexp(exponentials()[logs & ((1 << BITS) - 1)], (logs >> BITS).astype(np.int32))


def _frozen(values: list[int]) -> np.ndarray:
    table = np.array(values, dtype=np.int64)
    table.setflags(write=False)
    return table
