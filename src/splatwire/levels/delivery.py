"""When the tiles of a scene arrive, in virtual time: a link of one rate, and a sender that knows where somebody looks.

The receiver says ten times a second where it looks and what came. The sender sends the packets of the tiles that the
view wants (`cut_of`), the most useful first, and those again that were lost; it counts as there what is on its way.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from splatwire.channel import LossModel, Nothing
from splatwire.channel.transmit import DATAGRAM_BYTES
from splatwire.errors import InvalidValueError
from splatwire.levels.tiles import tiles_of
from splatwire.packets import SceneStream
from splatwire.packets.tiles import Tiles
from splatwire.packets.view import Look, cut_of

REPORT_SECONDS = 0.1
"""How often a receiver says where it looks."""
TRIPS_BEFORE = 3
"""One-way trips before the first byte is sent: two of a handshake, and that of the request."""
MOST = 0.75
"""Share of a tile's packets with which it is drawn: they lie evenly over it, and what is lost comes again."""


@dataclass(frozen=True)
class Link:
    """A link in virtual time.

    Attributes:
        rate: Bits per second, above 0.
        delay: Of one way, seconds.
        loss: What becomes of datagrams, in the order in which they are sent; the head of the stream is not lost.
        seed: Of the losses.

    Raises:
        InvalidValueError: If the rate is not above 0, or the delay negative.
    """

    rate: float
    delay: float = 0.02
    loss: LossModel = field(default_factory=lambda: Nothing(unit="datagram"))
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.rate <= 1e12:
            raise InvalidValueError(f"a rate is above 0 and at most 10^12 bits per second, {self.rate:g} is not")
        if not 0 <= self.delay <= 10:
            raise InvalidValueError(f"a delay is from 0 to 10 seconds, {self.delay:g} is not")


@dataclass(frozen=True, eq=False)
class Delivery:
    """What came when.

    Attributes:
        head: Seconds until the head of the stream was there.
        arrivals: Seconds until each packet came, those of the stream by their ids, float64 (P); infinite for those that
            did not.
        sent_bytes: Bytes of packets that were sent, those that were lost included.
        blocks: Tile of each packet, int64 (P).
        sizes: Bytes of each packet, int64 (P).
    """

    head: float
    arrivals: np.ndarray
    sent_bytes: int
    blocks: np.ndarray
    sizes: np.ndarray

    def there(self, tiles: Tiles, seconds: float) -> np.ndarray:
        """Which tiles can be drawn at a time, bool (B): those of which `MOST` came, of the coarsest ones a packet."""
        return _drawable(tiles, self.blocks, self.arrivals <= seconds)

    def bytes_at(self, seconds: float) -> int:
        """Bytes of packets that came until a time."""
        return int(self.sizes[self.arrivals <= seconds].sum())


def deliver(
    stream: SceneStream, look_at: Callable[[float], Look], seconds: float, link: Link,
    progress: Callable[[float], None] | None = None,
) -> Delivery:  # fmt: skip
    """Sends a complete stream with levels to somebody who looks around.

    Args:
        stream: The stream.
        look_at: Where from at a time, seconds from the moment when somebody asked for the scene.
        seconds: How long it is sent.
        link: How it travels.
        progress: Called with the share of the time that has passed.

    Raises:
        InvalidValueError: If packets are missing.
        BitstreamError: If it has no levels.
    """
    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError("packets are missing: only a complete stream can be sent in virtual time")
    tiles, packets = tiles_of(stream), sorted(stream.packets, key=lambda packet: packet.id)
    blocks = np.array([packet.id.block for packet in packets], dtype=np.int64)
    sizes = np.array([packet.num_bytes for packet in packets], dtype=np.int64)
    head_bytes = stream.num_bytes - int(tiles.sizes.sum())
    sender = _Sender(tiles, blocks, sizes, link, seconds)
    now = TRIPS_BEFORE * link.delay + 8 * head_bytes / link.rate
    head, sender.now = now + link.delay, now
    reported: float | None = None  # before the first report a sender goes from coarse to fine
    while sender.now < seconds:
        heard = None if reported is None else reported + link.delay
        sender.plan(None if reported is None else look_at(reported), reported)
        reported = head if reported is None else reported + REPORT_SECONDS
        sender.send(until=reported + link.delay)
        if progress and heard is not None:
            progress(min(heard / seconds, 1.0))
    return Delivery(head, sender.arrivals, sender.sent_bytes, blocks, sizes)


class _Sender:
    """Sends packets one after another, and knows of those that came what reports said."""

    def __init__(self, tiles: Tiles, blocks: np.ndarray, sizes: np.ndarray, link: Link, seconds: float) -> None:
        self._tiles, self._blocks, self._sizes, self._link = tiles, blocks, sizes, link
        self._first = np.searchsorted(blocks, np.arange(tiles.num_tiles + 1))
        datagrams = -(-sizes // DATAGRAM_BYTES)
        most = int(seconds * link.rate / 8 // max(int(sizes.min()), 1)) + 2
        fates = link.loss.received(most * int(datagrams.max()), np.random.default_rng(link.seed))
        self._datagrams, self._fates, self._drawn = datagrams, fates, 0
        self._sent = np.full(len(sizes), np.inf)  # when each would be there
        self.arrivals = np.full(len(sizes), np.inf)
        self._queue: Sequence[int] = ()
        self.now, self.sent_bytes = 0.0, 0

    def plan(self, look: Look | None, reported: float | None) -> None:
        """What to send next: of tiles that the view wants, packets that were not sent, or lost as a report says."""
        if reported is not None:
            lost = (self._sent <= reported) & ~(self.arrivals <= reported)
            self._sent[lost] = np.inf
        under_way = np.isfinite(self._sent)
        missing = np.bincount(self._blocks[~under_way], minlength=self._tiles.num_tiles)
        wanted = cut_of(self._tiles, missing == 0, look).wanted
        runs = (np.arange(self._first[tile], self._first[tile + 1]) for tile in wanted)
        self._queue = [int(packet) for run in runs for packet in run if not under_way[packet]]

    def send(self, until: float) -> None:
        """Sends until the next report is heard, or nothing is left to send."""
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


def _drawable(tiles: Tiles, blocks: np.ndarray, came: np.ndarray) -> np.ndarray:
    """Tiles of which most packets came, and coarsest ones of which one did: nothing else stands for those."""
    there = np.bincount(blocks[came], minlength=tiles.num_tiles)
    return np.asarray((there >= MOST * tiles.packets) | ((tiles.parents < 0) & (there > 0)))
