"""SplitMix64, the hash that assigns elements to packets.

Source of the constants: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014, in
the public-domain form of S. Vigna.
"""

import numpy as np

from splatwire.errors import InvalidValueError, shown

GAMMA = 0x9E3779B97F4A7C15
"""Increment of the generator's state: the golden ratio in 64 bits."""

MULTIPLIERS = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
MASK64 = (1 << 64) - 1


def splitmix64(x: np.ndarray) -> np.ndarray:
    """Hashes 64-bit numbers: n maps to the first output of the SplitMix64 generator seeded with n.

    Args:
        x: Numbers, uint64, any shape.

    Returns:
        Hashes, uint64, same shape.

    Raises:
        InvalidValueError: If `x` is not uint64 (signed numbers would hash differently after a silent conversion).
    """
    if not isinstance(x, np.ndarray) or x.dtype != np.uint64:
        raise InvalidValueError(f"x: splitmix64 hashes an array of uint64, not {shown(x)}")
    z = np.atleast_1d(x) + np.uint64(GAMMA)  # arrays wrap around silently; numpy scalars would warn
    z ^= z >> np.uint64(30)
    z *= np.uint64(MULTIPLIERS[0])
    z ^= z >> np.uint64(27)
    z *= np.uint64(MULTIPLIERS[1])
    z ^= z >> np.uint64(31)
    return z.reshape(x.shape)
