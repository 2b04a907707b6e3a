"""Random numbers of tests: the sequences of torch's CPU generator, without torch."""

import math

import numpy as np

from splatwire.ops.twister import Twister


class Numbers(Twister):
    """A generator; equal seeds give what torch's functions of the same names give.

    Args:
        seed: Seed, 0 to 2**32 - 1.
    """

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self._spare: float | None = None

    def randn(self, *shape: int) -> np.ndarray:
        """Normal numbers, float32; if fewer than sixteen, each pair is computed from two numbers of 53 bits."""
        count = math.prod(shape)
        found = self.normal(count) if count >= 16 else np.array([self._one() for _ in range(count)], np.float32)
        return found.reshape(shape)

    def rand(self, *shape: int) -> np.ndarray:
        """Numbers in [0, 1), float32."""
        return self.uniform(math.prod(shape)).reshape(shape)

    def randint(self, high: int, *shape: int) -> np.ndarray:
        """Whole numbers below `high`, int64."""
        return (self._numbers(math.prod(shape)) % high).astype(np.int64).reshape(shape)

    def randperm(self, count: int, first: int | None = None) -> np.ndarray:
        """The first numbers of a permutation of those below `count`, int64; all of them where `first` is absent."""
        found, moved = [], dict[int, int]()
        draws = self._numbers(max(count - 1, 0)).tolist()
        for place in range(count if first is None else min(first, count)):
            other = place + (draws[place] % (count - place) if place < count - 1 else 0)
            found.append(moved.get(other, other))
            moved[other] = moved.get(place, place)
        return np.array(found, np.int64)

    def _one(self) -> float:
        if self._spare is not None:
            found, self._spare = self._spare, None
            return found
        high, low = self._numbers(4).astype(np.uint64).reshape(2, 2).T
        first, second = (((high << np.uint64(32)) | low) & np.uint64((1 << 53) - 1)).astype(np.float64) * 2.0**-53
        radius = math.sqrt(-2 * math.log1p(-second))
        self._spare = radius * math.sin(2 * math.pi * first)
        return radius * math.cos(2 * math.pi * first)
