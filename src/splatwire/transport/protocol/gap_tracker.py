"""Tracks missing datagrams by sequence number, for NACKs when the order of packets depends on the viewpoint."""

from bisect import bisect_right
from collections.abc import Iterator

from splatwire.transport.protocol.nack import MAX_NACK_ATTEMPTS, NackTracker

MAX_GAPS = 4096
"""Maximum number of missing sequence numbers that are stored; the oldest are dropped first."""


class GapTracker:
    """Tracks the sequence numbers of missing datagrams on the receiver, and decides when to request them."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._stops: list[int] = []
        self._count = 0
        self._nack_tracker = NackTracker()
        # A retransmission has a new sequence number, so the tracker cannot see if it has been received.
        self._nack_tracker.max_attempts = MAX_NACK_ATTEMPTS

    def on_received(self, sequence: int, largest: int) -> None:
        """Records a received datagram, and the gap of missing datagrams before this datagram.

        Args:
            sequence: Sequence number of the datagram.
            largest: Largest sequence number received before it.
        """
        if sequence <= largest:
            self._discard(sequence)
            return
        start = max(largest + 1, sequence - MAX_GAPS)
        if start == sequence:
            return
        self._starts.append(start)
        self._stops.append(sequence)
        self._count += sequence - start
        while self._count > MAX_GAPS:
            surplus = min(self._count - MAX_GAPS, self._stops[0] - self._starts[0])
            for number in range(self._starts[0], self._starts[0] + surplus) if self._nack_tracker else ():
                self._nack_tracker.forget(number)
            self._starts[0] += surplus
            self._count -= surplus
            if self._starts[0] == self._stops[0]:
                del self._starts[0], self._stops[0]

    def due(self, before: int, now: float) -> list[int]:
        """Returns the sequence numbers to request in the next feedback report.

        Args:
            before: Upper limit (exclusive) on the sequence numbers. Later datagrams are not requested, because they may
                still arrive out of order.
            now: Time, seconds.
        """
        for number in [number for number in self._below(before) if self._attempts(number) >= MAX_NACK_ATTEMPTS]:
            self._discard(number)
        return self._nack_tracker.due(self._below(before), now)

    def _attempts(self, number: int) -> int:
        return self._nack_tracker.attempts(number)

    def _below(self, before: int) -> Iterator[int]:
        """Yields the sequence numbers of missing datagrams below `before`, ascending."""
        for start, stop in zip(self._starts, self._stops, strict=True):
            if start >= before:
                return
            yield from range(start, min(stop, before))

    def _discard(self, number: int) -> None:
        """Removes a sequence number from the missing numbers. A number that is not missing is ignored."""
        at = bisect_right(self._starts, number) - 1
        if at < 0 or number >= self._stops[at]:
            return
        self._nack_tracker.forget(number)
        start, stop = self._starts[at], self._stops[at]
        parts = [(first, last) for first, last in ((start, number), (number + 1, stop)) if first < last]
        self._starts[at : at + 1] = [first for first, _ in parts]
        self._stops[at : at + 1] = [last for _, last in parts]
        self._count -= 1

    def __bool__(self) -> bool:
        return self._count > 0
