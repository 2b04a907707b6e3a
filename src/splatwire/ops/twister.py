"""Random numbers that are the same on every machine and in every release."""

import numpy as np


class Twister:
    """A Mersenne twister (MT19937), whose sequence of 32-bit numbers is fixed for good.

    Args:
        seed: Seed of the generator, 0 to 2**32 - 1.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.RandomState(seed)

    def signs(self, shape: tuple[int, ...]) -> np.ndarray:
        """Returns the next signs, -1 or 1, float32 of a shape: the lowest bit of each number."""
        return ((self._numbers(int(np.prod(shape))) & 1).astype(np.float32) * 2 - 1).reshape(shape)

    def uniform(self, count: int) -> np.ndarray:
        """Returns the next numbers in [0, 1), float32 (count): the lowest 24 bits of each number."""
        return (self._numbers(count) & 0xFFFFFF).astype(np.float32) * np.float32(2.0**-24)

    def _numbers(self, count: int) -> np.ndarray:
        return self._rng.randint(0, 1 << 32, count, dtype=np.uint32)
