"""What has arrived of one stream, in any order and from any thread; which of it is new."""

import threading
from collections.abc import Iterable

from splatwire.packets import Manifest, Packet, PacketId, PacketIntake, ReadReport, SceneStream


class Arrivals:
    """The packets of a stream that is being decoded while it arrives.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.

    Attributes:
        manifest: The stream's manifest.
        lock: Held while packets are taken, and by whoever reads several rows as of one moment.
        num_taken: Elements of the packets that were taken.
        num_bytes: Bytes of side information and of the packets that were taken.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, intake: PacketIntake | None) -> None:
        self.lock = threading.RLock()
        self.manifest, self._side_info = manifest, side_info
        self._intake = intake or PacketIntake(manifest)
        self._taken: set[PacketId] = set()
        self.num_taken, self.num_bytes = 0, len(side_info)

    @property
    def num_packets(self) -> int:
        """Packets that were taken."""
        return len(self._taken)

    @property
    def has_every_packet(self) -> bool:
        """Whether every packet was taken."""
        return len(self._taken) == self.manifest.num_packets

    @property
    def report(self) -> ReadReport:
        """Counts of good, missing, damaged, foreign and duplicate packets."""
        with self.lock:
            return self._intake.report()

    @property
    def stream(self) -> SceneStream:
        """What has arrived."""
        with self.lock:
            return SceneStream(self.manifest, self._side_info, self._intake.packets)

    def take(self, packets: Iterable[Packet]) -> list[Packet]:
        """Those that are to be decoded: they passed where they came in, or do here, and are new."""
        with self.lock:
            return [packet for packet in packets if self._takes(packet)]

    def _takes(self, packet: Packet) -> bool:
        passed = self._intake.has(packet) and packet.id not in self._taken
        if not passed and self._intake.take(packet, "transfer") is None:
            return False
        self._taken.add(packet.id)
        self.num_taken += packet.num_elements
        self.num_bytes += packet.num_bytes
        return True
