"""Collects the received packets of a stream, in any order and from any thread."""

import threading
from collections.abc import Iterable

from splatwire.bitstream import Manifest, Packet, PacketId, PacketIntake, ReadReport, SceneStream


class Arrivals:
    """Packets of a stream received so far, for decoding during a transfer; thread-safe.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: Packet filter of the receiver. A packet that this filter has accepted already is not validated again.
            None to create a filter, which validates all packets.

    Attributes:
        manifest: The stream's manifest.
        lock: Held while packets are added. Hold it to read a consistent state.
        num_accepted: Number of elements in all accepted packets.
        num_bytes: Bytes of side information and accepted packets.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, intake: PacketIntake | None) -> None:
        self.lock = threading.RLock()
        self.manifest, self._side_info = manifest, side_info
        self._intake = intake or PacketIntake(manifest)
        self._accepted: set[PacketId] = set()
        self.num_accepted, self.num_bytes = 0, len(side_info)

    @property
    def num_packets(self) -> int:
        """Number of accepted packets."""
        return len(self._accepted)

    @property
    def has_every_packet(self) -> bool:
        """True if every packet of the stream has been accepted."""
        return len(self._accepted) == self.manifest.num_packets

    @property
    def report(self) -> ReadReport:
        """Returns the numbers of valid, missing, damaged, foreign and duplicate packets."""
        with self.lock:
            return self._intake.report()

    @property
    def stream(self) -> SceneStream:
        """Returns the stream with the packets received so far."""
        with self.lock:
            return SceneStream(self.manifest, self._side_info, self._intake.packets)

    def take(self, packets: Iterable[Packet]) -> list[Packet]:
        """Adds received packets, except invalid packets and duplicates; returns the packets that were added."""
        with self.lock:
            return [packet for packet in packets if self._accept(packet)]

    def _accept(self, packet: Packet) -> bool:
        passed = self._intake.has(packet) and packet.id not in self._accepted
        if not passed and self._intake.add(packet, "transfer") is None:
            return False
        self._accepted.add(packet.id)
        self.num_accepted += packet.num_elements
        self.num_bytes += packet.num_bytes
        return True
