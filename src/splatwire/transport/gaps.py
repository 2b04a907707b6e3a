"""Which datagrams did not come, by their sequence numbers: all that is known where views order what is sent."""

from bisect import bisect_right
from collections.abc import Iterator

from splatwire.transport.asked import Asked
from splatwire.transport.frames import BY_SEQUENCE

MOST_GAPS = 4096
"""Numbers that are remembered: of more, those from long ago are nobody's loss any more."""
TRIES = 8
"""A number is asked for so often: the answer has another one, so that nobody hears whether the question came."""


class Gaps:
    """Numbers that are missing, as ascending ranges: a jump of the sequence costs no more than a single loss."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._stops: list[int] = []
        self._count = 0
        self._asked = Asked()
        self._asked.most = TRIES

    def came(self, sequence: int, largest: int) -> None:
        """Takes a number; the largest one before it."""
        if sequence <= largest:
            self._discard(sequence)
            return
        start = max(largest + 1, sequence - MOST_GAPS)
        if start == sequence:
            return
        self._starts.append(start)
        self._stops.append(sequence)
        self._count += sequence - start
        while self._count > MOST_GAPS:
            surplus = min(self._count - MOST_GAPS, self._stops[0] - self._starts[0])
            for number in range(self._starts[0], self._starts[0] + surplus) if self._asked else ():
                self._asked.forget(BY_SEQUENCE + number)
            self._starts[0] += surplus
            self._count -= surplus
            if self._starts[0] == self._stops[0]:
                del self._starts[0], self._stops[0]

    def due(self, before: int, now: float) -> list[int]:
        """Those below a number that are asked for now, as `Feedback` has them; others are given up."""
        for number in [number for number in self._below(before) if self._times(number) >= TRIES]:
            self._discard(number)
        return self._asked.due((BY_SEQUENCE + number for number in self._below(before)), now)

    def _times(self, number: int) -> int:
        return self._asked.times(BY_SEQUENCE + number)

    def _below(self, before: int) -> Iterator[int]:
        """Missing numbers below one, ascending."""
        for start, stop in zip(self._starts, self._stops, strict=True):
            if start >= before:
                return
            yield from range(start, min(stop, before))

    def _discard(self, number: int) -> None:
        """Takes one number out."""
        at = bisect_right(self._starts, number) - 1
        if at < 0 or number >= self._stops[at]:
            return
        self._asked.forget(BY_SEQUENCE + number)
        start, stop = self._starts[at], self._stops[at]
        parts = [(first, last) for first, last in ((start, number), (number + 1, stop)) if first < last]
        self._starts[at : at + 1] = [first for first, _ in parts]
        self._stops[at : at + 1] = [last for _, last in parts]
        self._count -= 1

    def __bool__(self) -> bool:
        return self._count > 0
