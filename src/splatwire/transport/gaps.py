"""Which datagrams did not come, by their sequence numbers: all that is known where views order what is sent."""

from splatwire.transport.asked import Asked
from splatwire.transport.frames import BY_SEQUENCE

MOST_GAPS = 4096
"""Numbers that are remembered: of more, those from long ago are nobody's loss any more."""
TRIES = 8
"""A number is asked for so often: the answer has another one, so that nobody hears whether the question came."""


class Gaps:
    """Numbers that are missing."""

    def __init__(self) -> None:
        self._missing: dict[int, None] = {}
        self._asked = Asked()
        self._asked.most = TRIES

    def came(self, sequence: int, largest: int) -> None:
        """Takes a number; the largest one before it."""
        if sequence <= largest:
            self._missing.pop(sequence, None)
            return
        for number in range(max(largest + 1, sequence - MOST_GAPS), sequence):
            self._missing[number] = None
        while len(self._missing) > MOST_GAPS:
            del self._missing[next(iter(self._missing))]

    def due(self, before: int, now: float) -> list[int]:
        """Those below a number that are asked for now, as `Feedback` has them; others are given up."""
        lost = [number for number in self._missing if number < before]
        for number in lost:
            if self._asked.times(BY_SEQUENCE + number) >= TRIES:
                del self._missing[number]
        return self._asked.due((BY_SEQUENCE + number for number in lost if number in self._missing), now)

    def __bool__(self) -> bool:
        return bool(self._missing)
