"""Random numbers that are identical on every machine and in every release."""

import numpy as np

_BLOCK = 16


class Twister:
    """Generator of random numbers that are equal on all machines: a Mersenne twister (MT19937).

    Args:
        seed: Seed of the generator, 0 to 2**32 - 1.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.RandomState(seed)

    def signs(self, shape: tuple[int, ...]) -> np.ndarray:
        """Returns random signs, -1 or 1, float32 of the given shape."""
        return ((self._numbers(int(np.prod(shape))) & 1).astype(np.float32) * 2 - 1).reshape(shape)

    def uniform(self, count: int) -> np.ndarray:
        """Returns random numbers in [0, 1), float32 (count)."""
        return (self._numbers(count) & 0xFFFFFF).astype(np.float32) * np.float32(2.0**-24)

    def normal(self, count: int) -> np.ndarray:
        """Returns standard normal random numbers, float32 (count), by the Box-Muller method."""
        uniform = self.uniform(max(count, _BLOCK))
        whole = len(uniform) // _BLOCK * _BLOCK
        values = _normal(uniform[:whole])
        if whole < len(uniform):
            values = np.concatenate([values, uniform[whole:]])
            values[-_BLOCK:] = _normal(self.uniform(_BLOCK))
        return values[:count]

    def _numbers(self, count: int) -> np.ndarray:
        return self._rng.randint(0, 1 << 32, count, dtype=np.uint32)


def _normal(uniform: np.ndarray) -> np.ndarray:
    """Converts uniform random numbers to normal ones by the Box-Muller method, in blocks of sixteen."""
    first, second = uniform.reshape(-1, 2, _BLOCK // 2).swapaxes(0, 1)
    radius, angle = np.sqrt(-2 * np.log(1 - first)), np.float32(2 * np.pi) * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).ravel()
