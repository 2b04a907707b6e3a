"""What arrived of a stream so far, as whoever receives it asks for it."""

from splatwire.packets import Manifest, ReadReport, SceneStream
from splatwire.transport.collect import HeadCollector, PacketCollector
from splatwire.transport.events import Finished
from splatwire.transport.frames import Data, Welcome

MOST_NEWER = 512
"""Packets that wait for a welcome: over QUIC datagrams overtake the stream that it travels on."""


class Arrived:
    """What is there.

    Attributes:
        finished: How it ended; None before.
        num_datagrams: Datagrams of the transfer that came.
        num_rejected: Others.
        num_bytes: Bytes of all that could be read.
    """

    def __init__(self) -> None:
        self.finished: Finished | None = None
        self.num_datagrams = self.num_rejected = self.num_bytes = 0
        self._welcome: Welcome | None = None
        self._head: HeadCollector | None = None
        self._collector: PacketCollector | None = None
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._newer: list[Data] = []
        self._grew = False

    def _begin(self, welcome: Welcome, *, anew: bool) -> None:
        """Waits for what a checked welcome declares: all of it, or what is new of a stream that has grown."""
        self._welcome, self._head = welcome, HeadCollector(welcome)
        self._grew = welcome.open or (self._grew and not anew)
        if anew or self._collector is None:
            self._collector, self._manifest, self._side_info = PacketCollector(welcome), None, b""
        else:
            self._collector.renew(welcome)
        newer, self._newer = self._newer, []
        for frame in newer:
            self._collector.add(frame)

    def _resume(self, before: Welcome, welcome: Welcome) -> bool:
        """Goes on with what is there in another transfer of the same stream; returns False if it cannot be kept."""
        if self._collector is None or welcome.stream_id != before.stream_id:
            return False
        same = welcome.digest == before.digest and _layout(welcome) == _layout(before)
        grown = before.open and welcome.num_packets >= before.num_packets
        if not same and not grown:
            return False
        if same:
            self._welcome = welcome
        else:
            self._begin(welcome, anew=False)
        return True

    def _ahead(self, frame: Data) -> bool:
        """Whether a packet of a stream that grows is ahead of the welcome that tells of it, for which it waits."""
        welcome = self._welcome
        if welcome is None or not welcome.open:
            return False
        told = frame.place < welcome.num_packets and frame.packet[1:5] == welcome.stream_id.to_bytes(4, "little")
        if not told and len(self._newer) < MOST_NEWER:
            self._newer.append(frame)
        return not told

    @property
    def is_live(self) -> bool:
        """Whether the stream grew while it was received: nobody can have what was sent before."""
        return self._grew

    @property
    def welcome(self) -> Welcome | None:
        """What the server declared, once it did."""
        return self._welcome

    @property
    def preview(self) -> bytes:
        """What the welcome shows of the scene, as it came; empty before it, and where there is none."""
        return self._welcome.preview if self._welcome else b""

    @property
    def collector(self) -> PacketCollector | None:
        """The packets so far."""
        return self._collector

    def stream(self) -> SceneStream | None:
        """What is there by now; None as long as side information is missing."""
        if self._manifest is None or self._collector is None:
            return None
        return SceneStream(self._manifest, self._side_info, self._collector.packets)

    def report(self) -> ReadReport | None:
        """Counts of the packets; None as long as side information is missing."""
        intake = self._collector.intake if self._collector else None
        return intake.report() if intake else None

    def lacking(self) -> str:
        """What is missing, in words; empty before the server declared what there is."""
        if self._welcome is None or self._collector is None:
            return ""
        packets = f"{self._collector.num_packets} of {self._welcome.num_packets} packets arrived"
        if self._head is None:
            return packets
        missing, total = self._head.num_missing, self._head.num_symbols
        return f"of the side information at least {missing} of {total} pieces are missing; {packets}"


def _layout(welcome: Welcome) -> tuple[object, ...]:
    """Facts of a stream by which packets have their places."""
    return welcome.object_bytes, welcome.symbol_bytes, welcome.num_packets, welcome.carried, welcome.tiers
