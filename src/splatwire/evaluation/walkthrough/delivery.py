"""Simulated transmission of a scene in tiles over a link of constant rate, controlled by the receiver's viewpoint.

The receiver reports its viewpoint and the received packets ten times per second. The sender sends the packets of the
tiles that the viewpoint needs, most useful first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.bitstream.packetization import DATAGRAM_BYTES
from splatwire.bitstream.tile_selection import Viewpoint, cut_of
from splatwire.bitstream.tiles import Tiles
from splatwire.channel import LossModel, NoLoss
from splatwire.channel.loss_models import draw_checked
from splatwire.errors import InvalidValueError
from splatwire.lod.tiles import tiles_of

REPORT_SECONDS = 0.1
"""Interval of the receiver's reports of its viewpoint and received packets, seconds."""
TRIPS_BEFORE = 3
"""Number of one-way delays before the first byte is sent: two for the handshake, one for the request."""
DRAWABLE_SHARE = 0.75
"""Share of a tile's packets that must be received to draw the tile. The Gaussians of a packet are spread evenly over
the tile, and lost packets are retransmitted."""


@dataclass(frozen=True)
class Link:
    """A simulated network link.

    Attributes:
        rate: Bits per second, above 0 and at most 10^12.
        delay: One-way delay, 0 to 10 seconds.
        loss: Loss model of datagrams.
        seed: Random seed of the simulated losses of datagrams.

    Raises:
        InvalidValueError: If the rate or the delay is out of range.
    """

    # The head of the stream (manifest and side information) is never lost.

    rate: float
    delay: float = 0.02
    loss: LossModel = field(default_factory=lambda: NoLoss(unit="datagram"))
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.rate <= 1e12:
            raise InvalidValueError(f"a rate is above 0 and at most 10^12 bits per second, {self.rate:g} is not")
        if not 0 <= self.delay <= 10:
            raise InvalidValueError(f"a delay is from 0 to 10 seconds, {self.delay:g} is not")


@dataclass(frozen=True, eq=False)
class Delivery:
    """Arrival times of the P packets of a stream, in seconds since the request.

    Attributes:
        head: Time at which the manifest and the side information of the stream have arrived.
        arrivals: Arrival time of each packet, ordered by packet id, float64 (P); infinite for packets that never
            arrived.
        sent_bytes: Bytes of all sent packets, including lost ones.
        tile_of_packet: Index of the tile that each packet belongs to, int64 (P).
        sizes: Bytes of each packet, int64 (P).
    """

    head: float
    arrivals: np.ndarray
    sent_bytes: int
    tile_of_packet: np.ndarray
    sizes: np.ndarray

    def drawable(self, tiles: Tiles, seconds: float) -> np.ndarray:
        """Returns the mask of tiles that are received far enough to be drawn, bool (B).

        Args:
            tiles: The B tiles.
            seconds: Time since the request, seconds.
        """
        return _drawable_tiles(tiles, self.tile_of_packet, self.arrivals <= seconds)

    def bytes_at(self, seconds: float) -> int:
        """Returns the number of packet bytes received until a time."""
        return int(self.sizes[self.arrivals <= seconds].sum())


def deliver(
    stream: SceneStream, viewpoint_at: Callable[[float], Viewpoint], seconds: float, link: Link,
    progress: Callable[[float], None] | None = None,
) -> Delivery:  # fmt: skip
    """Simulates the transmission of a complete stream with levels of detail to a viewer who moves.

    Args:
        stream: The stream.
        viewpoint_at: Function that returns the viewpoint at a time, given in seconds since the request.
        seconds: Duration of the simulation, seconds.
        link: The link.
        progress: Called with the simulated share of the duration.

    Raises:
        InvalidValueError: If packets are missing.
        BitstreamError: If the stream has no levels of detail.
    """
    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError("packets are missing: only a complete stream can be sent in virtual time")
    tiles, packets = tiles_of(stream), sorted(stream.packets, key=lambda packet: packet.id)
    tile_of_packet = np.array([packet.id.block for packet in packets], dtype=np.int64)
    sizes = np.array([packet.num_bytes for packet in packets], dtype=np.int64)
    head_bytes = stream.num_bytes - int(tiles.sizes.sum())
    sender = _Sender(tiles, tile_of_packet, sizes, link, seconds)
    now = TRIPS_BEFORE * link.delay + 8 * head_bytes / link.rate
    head, sender.now = now + link.delay, now
    reported: float | None = None  # until the first report, the sender sends coarse levels first
    while sender.now < seconds:
        heard = None if reported is None else reported + link.delay
        sender.plan(None if reported is None else viewpoint_at(reported), reported)
        reported = head if reported is None else reported + REPORT_SECONDS
        sender.send(until=reported + link.delay)
        if progress and heard is not None:
            progress(min(heard / seconds, 1.0))
    return Delivery(head, sender.arrivals, sender.sent_bytes, tile_of_packet, sizes)


class _Sender:
    """Simulated sender of packets, which learns about losses only from the receiver's reports."""

    def __init__(self, tiles: Tiles, tile_of_packet: np.ndarray, sizes: np.ndarray, link: Link, seconds: float) -> None:
        self._tiles, self._tile_of_packet, self._sizes, self._link = tiles, tile_of_packet, sizes, link
        self._first = np.searchsorted(tile_of_packet, np.arange(tiles.num_tiles + 1))
        datagrams = -(-sizes // DATAGRAM_BYTES)
        most = int(seconds * link.rate / 8 // max(int(sizes.min()), 1)) + 2
        fates = draw_checked(link.loss, most * int(datagrams.max()), np.random.default_rng(link.seed))
        self._datagrams, self._fates, self._drawn = datagrams, fates, 0
        self._sent = np.full(len(sizes), np.inf)  # expected arrival times
        self.arrivals = np.full(len(sizes), np.inf)
        self._queue: Sequence[int] = ()
        self.now, self.sent_bytes = 0.0, 0

    def plan(self, viewpoint: Viewpoint | None, reported: float | None) -> None:
        """Replaces the queue by the unsent packets of the tiles that a viewpoint needs.

        A packet that was sent counts as unsent again if the report shows that it was lost.

        Args:
            viewpoint: Reported viewpoint of the receiver; None before the first report.
            reported: Time of the report, seconds; None before the first report.
        """
        # Packets that were sent are queued again only if the receiver's report shows them as lost.
        if reported is not None:
            lost = (self._sent <= reported) & ~(self.arrivals <= reported)
            self._sent[lost] = np.inf
        under_way = np.isfinite(self._sent)
        missing = np.bincount(self._tile_of_packet[~under_way], minlength=self._tiles.num_tiles)
        wanted = cut_of(self._tiles, missing == 0, viewpoint).wanted
        runs = (np.arange(self._first[tile], self._first[tile + 1]) for tile in wanted)
        self._queue = [int(packet) for run in runs for packet in run if not under_way[packet]]

    def send(self, until: float) -> None:
        """Sends queued packets until a given time, or until the queue is empty.

        Args:
            until: Time at which the next report of the receiver arrives at the sender, seconds.
        """
        for packet in self._queue:
            if self.now >= until:
                return
            self.now += 8 * int(self._sizes[packet]) / self._link.rate
            self.sent_bytes += int(self._sizes[packet])
            self._sent[packet] = self.now + self._link.delay
            count = int(self._datagrams[packet])
            if self._fates[self._drawn : self._drawn + count].all():
                self.arrivals[packet] = self._sent[packet]
            self._drawn += count
        self.now = max(self.now, until)


def _drawable_tiles(tiles: Tiles, tile_of_packet: np.ndarray, received: np.ndarray) -> np.ndarray:
    """Returns the mask of tiles that can be drawn, bool (B).

    A tile can be drawn once at least the share `DRAWABLE_SHARE` of its packets is received. For tiles of the coarsest
    level of detail, one packet suffices.

    Args:
        tiles: The B tiles.
        tile_of_packet: Index of each packet's tile, int64 (P).
        received: Mask of received packets, bool (P).
    """
    # One packet suffices for tiles of the coarsest level, because no other level can replace them.
    num_received = np.bincount(tile_of_packet[received], minlength=tiles.num_tiles)
    return np.asarray((num_received >= DRAWABLE_SHARE * tiles.packets) | ((tiles.parents < 0) & (num_received > 0)))
