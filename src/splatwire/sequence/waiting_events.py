"""Queue of received events that wait for decoding, with a limit in bytes."""

import threading
from collections import deque

from splatwire.transport.protocol.events import Event, PacketArrived, SideInfoArrived

MAX_WAITING_BYTES = 512 << 20
"""Size of the waiting events from which on packets are dropped, bytes: five minutes of packets at 10 Mbit/s."""
OBJECT_BYTES = 512
"""Assumed memory of the Python objects of an event or of a tier of a manifest, bytes."""


class WaitingEvents:
    """Bounded event queue between the receiver of a live sequence and the decoding thread.

    It contains only the events that the decoder uses: packets, and manifests with side information. A full queue drops
    new packets, but no manifests. Of two manifests in a row, the older is dropped if both belong to the same stream or
    the queue is full.
    """

    def __init__(self) -> None:
        self._events: deque[PacketArrived | SideInfoArrived] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self.num_bytes = 0

    def put(self, event: Event) -> bool:
        """Adds an event to the queue if it is about received data; other events are ignored.

        Returns:
            False if the event is a packet and was dropped because the queue is full; otherwise True.
        """
        if not isinstance(event, (PacketArrived, SideInfoArrived)):
            return True
        with self._changed:
            is_full = self.num_bytes >= MAX_WAITING_BYTES
            if is_full and isinstance(event, PacketArrived):
                return False
            if self._events and _replaces(event, self._events[-1], is_full):
                self.num_bytes -= _size(self._events.pop())
            self._events.append(event)
            self.num_bytes += _size(event)
            self._changed.notify()
        return True

    def end(self) -> None:
        """Marks the end of the transfer."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def get(self) -> PacketArrived | SideInfoArrived | None:
        """Waits for the oldest event and removes this event from the queue.

        Returns None after the end of the transfer.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._events or self._ended)
            if not self._events:
                return None
            event = self._events.popleft()
            self.num_bytes -= _size(event)
            return event

    def empty(self) -> bool:
        """True if the queue has no events."""
        return not self._events


def _replaces(event: Event, last: Event, is_full: bool) -> bool:
    """True if a new event makes the last event in the queue unnecessary.

    This is the case if both are manifests of the same stream. In a full queue, it is the case for any two manifests.

    Args:
        event: The new event.
        last: The last event in the queue.
        is_full: True if the queue is full.
    """
    # The last manifest of another stream declares its last frames, and is only left out if the queue is full.
    if not isinstance(event, SideInfoArrived) or not isinstance(last, SideInfoArrived):
        return False
    return is_full or event.manifest.stream_id == last.manifest.stream_id


def _size(event: PacketArrived | SideInfoArrived) -> int:
    """Returns the approximate memory of an event, bytes."""
    if isinstance(event, PacketArrived):
        return event.packet.num_bytes + OBJECT_BYTES
    return len(event.side_info) + (1 + len(event.manifest.tiers)) * OBJECT_BYTES
