"""Queue of the datagrams of one transfer, in a fixed order or in an order that depends on the viewpoint."""

from array import array
from collections import deque

import numpy as np

from splatwire.bitstream.tile_selection import Viewpoint, cut_of
from splatwire.transport.protocol.messages import ViewUpdate
from splatwire.transport.protocol.send_schedule import ScheduledDatagram
from splatwire.transport.protocol.served_stream import SendSchedule, ServedStream
from splatwire.transport.protocol.wire import DATA, WELCOME

WELCOME_ITEM: ScheduledDatagram = WELCOME, 0, 0
"""Welcome of a live stream, which declares its new sizes."""
MAX_LOGGED_DATAGRAMS = 8192
"""Number of latest datagrams with stored packet indices."""
VIEW_UPDATE_COST_S = 2e-3
"""Time reserved to process a client's new viewpoint, seconds. About five times the actual cost, so that viewpoints use
at most a fifth of the server's time.
"""
TILE_COST_S = 1e-6
"""Additional time for each tile of the scene, seconds."""
VIEW_INTERVAL_S = 0.1
"""Minimum interval between two processed viewpoints of one client, seconds. Of the viewpoints received in between, only
the newest is processed.
"""


def viewpoint_of(message: ViewUpdate) -> Viewpoint:
    """Converts a received view update to a `Viewpoint`."""
    matrix = np.eye(4)
    matrix[:3] = np.array(message.viewmat).reshape(3, 4)
    return Viewpoint(matrix, message.focal, message.width, message.height)


class ViewUpdateBudget:
    """Limit on the processor time that a server spends on new viewpoints of its clients."""

    def __init__(self) -> None:
        self._free_at = 0.0

    def take(self, now: float, last_update_at: float | None, num_tiles: int) -> float:
        """Reserves processing time for a client's viewpoint, and returns the time at which to process it, seconds.

        Args:
            now: Time, seconds.
            last_update_at: Time at which the client's previous viewpoint was processed, seconds; None for the first.
            num_tiles: Number of tiles of the scene.
        """
        due_at = max(self._free_at, now if last_update_at is None else max(now, last_update_at + VIEW_INTERVAL_S))
        self._free_at = due_at + VIEW_UPDATE_COST_S + num_tiles * TILE_COST_S
        return due_at


class SentLog:
    """Log of recently sent datagrams: maps the sequence number of a datagram to its packet.

    The server needs this log if the receiver requests lost datagrams by sequence number (NACKs).

    Args:
        enabled: False to log nothing, because the receiver requests lost packets by packet index.
    """

    def __init__(self, enabled: bool) -> None:
        self._indices = array("I", bytes(4 * MAX_LOGGED_DATAGRAMS)) if enabled else None

    def record(self, sequence: int, packet_index: int) -> None:
        """Records a sent datagram.

        Args:
            sequence: Sequence number of the datagram.
            packet_index: Index of its packet in sending order; -1 without a packet.
        """
        if self._indices is not None:
            self._indices[sequence % MAX_LOGGED_DATAGRAMS] = packet_index + 1

    def packet_index(self, lost_sequence: int, next_sequence: int) -> int:
        """Returns the index in sending order of the packet that a lost datagram contained; -1 if unknown.

        Args:
            lost_sequence: Sequence number of the lost datagram.
            next_sequence: Sequence number of the next datagram to send; the log covers only the last datagrams before
                it.
        """
        if self._indices is None or not next_sequence - MAX_LOGGED_DATAGRAMS <= lost_sequence < next_sequence:
            return -1
        return self._indices[lost_sequence % MAX_LOGGED_DATAGRAMS] - 1

    def discard(self, sequence: int | None) -> None:
        """Removes a lost datagram from the log, so that the server ignores further NACKs for this datagram.

        Args:
            sequence: Sequence number of the datagram; None has no effect.
        """
        if sequence is not None:
            self.record(sequence, -1)


class SendQueue:
    """Queue of the datagrams that are sent to one client for the first time.

    Args:
        stream: Prepared stream to send.
        reliable: True if the init segment is sent on a reliable (QUIC) stream.

    Attributes:
        popped_last_init_symbol: True if the latest call of `pop` returned the last datagram of the init segment. False
            again after the next call.
        viewed_at: Time at which the client's last viewpoint was processed, seconds; None before the first.
    """

    def __init__(self, stream: ServedStream, reliable: bool) -> None:
        self._stream = stream
        self._schedule = stream.reliable_schedule if reliable else stream.send_schedule
        self._next, self._next_packet = 0, stream.num_bundled
        self.popped_last_init_symbol = False
        self._queued_tiles: np.ndarray | None = None
        self._tile_queue: deque[int] = deque()
        self._packet_queue: deque[int] = deque()
        self.viewed_at: float | None = None

    @property
    def has_viewpoint(self) -> bool:
        """True if the client has sent a viewpoint, so that the remaining order depends on the viewpoint."""
        return self.viewed_at is not None

    def __bool__(self) -> bool:
        """True if the queue is not empty."""
        return bool(self._packet_queue or self._tile_queue) or self._next < self._num_scheduled

    @property
    def _num_scheduled(self) -> int:
        """Number of datagrams in the part of the sending order that does not depend on the viewpoint."""
        return self._schedule.opening_end if self.has_viewpoint else len(self._schedule.datagrams)

    def pop(self) -> ScheduledDatagram:
        """Removes the next datagram from the queue and returns it."""
        if self._next < self._num_scheduled:
            item = self._schedule.datagrams[self._next]
            kind, _, index = item
            self._next += 1
            self._next_packet = index + 1 if kind == DATA else self._next_packet
            self.popped_last_init_symbol = self._next == self._schedule.init_segment_end
            return item
        self.popped_last_init_symbol = False
        if not self._packet_queue:
            self._queue_tile(self._tile_queue.popleft())
        return DATA, 0, self._packet_queue.popleft()

    def set_viewpoint(self, viewpoint: Viewpoint, budget: int, now: float) -> None:
        """Reorders the queue for a viewpoint: only visible tiles are sent, the most important first.

        Args:
            viewpoint: Viewpoint of the client, relative to the stream's origin.
            budget: Maximum number of Gaussians that the client renders.
            now: Time, seconds.
        """
        tiles = self._stream.tiles
        assert tiles is not None
        if self._queued_tiles is None:
            self._next_packet = max(self._next_packet, self._stream.opening_packets)
            self._queued_tiles = (tiles.first_packets[1:] <= self._next_packet) | (tiles.packets == 0)
            if not self._queued_tiles.all():  # finish the tile that the schedule has started
                self._queue_tile(int(np.argmin(self._queued_tiles)), only_rest=True)
        self.viewed_at = now
        self._tile_queue = deque(cut_of(tiles, self._queued_tiles, viewpoint, budget).wanted)

    def _queue_tile(self, tile: int, *, only_rest: bool = False) -> None:
        """Queues the packets of a tile.

        Args:
            tile: Index of the tile.
            only_rest: False to queue all packets of the tile. True to queue only the packets that were not yet sent. A
                tile is then skipped if none of its packets was sent.
        """
        tiles = self._stream.tiles
        assert tiles is not None
        assert self._queued_tiles is not None
        first, end = tiles.first_packets[tile : tile + 2].tolist()
        if only_rest and first >= self._next_packet:
            return
        self._queued_tiles[tile] = True
        self._packet_queue.extend(range(max(first, self._next_packet) if only_rest else first, end))

    def set_stream(self, stream: ServedStream, reliable: bool, num_packets_before: int) -> None:
        """Updates the send queue after a live stream has grown, or after another stream has replaced it.

        Args:
            stream: New state of the prepared stream.
            reliable: True if the init segment is sent on a reliable (QUIC) stream.
            num_packets_before: Number of packets of the live stream before its growth, sent or not; the new packets are
                added to the queue. 0 if another stream replaces the previous stream; the whole queue is then replaced.
        """
        self._stream = stream
        added = stream.added_datagrams(num_packets_before, reliable=reliable)
        remaining = stream.still_useful(self._schedule.datagrams[self._next :]) if num_packets_before else []
        # Three times: without the welcome, a client cannot place the init segment and most of the new packets.
        datagrams = (WELCOME_ITEM, *added.init_segment, WELCOME_ITEM, *remaining, WELCOME_ITEM, *added.packets)
        if stream.tiles is None:
            end = 1 + len(added.init_segment) if added.init_segment else 0
            self._schedule = SendSchedule(datagrams, end, 0)
        else:
            self._schedule = stream.schedule_of(datagrams)
        self._next = 0
