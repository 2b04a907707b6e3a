"""Which packets a receiver asks for again, and when."""

import sys
from collections.abc import Iterable

from splatwire.transport.frames import MAX_NACKS

AGAIN_S = 0.12
"""A packet is not asked for again within this time."""
MOST_TRIES = 8
"""A packet of a stream that grows is not asked for more often: what moves is worth nothing once its time has passed."""


class Asked:
    """What was asked for.

    Attributes:
        most: How often a packet is asked for at most.
    """

    def __init__(self) -> None:
        self.most = sys.maxsize
        self._last: dict[int, tuple[float, int]] = {}

    def times(self, index: int) -> int:
        """How often one was asked for."""
        return self._last.get(index, (0.0, 0))[1]

    def forget(self, index: int) -> None:
        """Forgets one that nobody will ask for."""
        self._last.pop(index, None)

    def __bool__(self) -> bool:
        return bool(self._last)

    def due(self, missing: Iterable[int], now: float) -> list[int]:
        """Those of the missing packets that are asked for now, the first ones: not those of a moment ago."""
        out: list[int] = []
        for index in missing:
            at, times = self._last.get(index, (-AGAIN_S, 0))
            if now - at >= AGAIN_S and times < self.most:
                self._last[index] = now, times + 1
                out.append(index)
                if len(out) == MAX_NACKS:
                    break
        return out
