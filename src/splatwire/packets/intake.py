"""What is done with bytes that claim to be packets: each is kept, or counted as a loss and why."""

import bisect
import threading
from dataclasses import asdict, dataclass
from typing import Any

from splatwire.errors import BitstreamError, CorruptPacketError, ForeignPacketError
from splatwire.packets.manifest import Manifest
from splatwire.packets.packet import Packet, packet_from_bytes
from splatwire.packets.packet_id import PacketId

MAX_PROBLEMS = 100
"""Problems that a report spells out; the counts go on."""
ALREADY_THERE = "was already there"
"""End of the problem that a copy of a packet is."""


@dataclass(frozen=True)
class ReadReport:
    """What reading a stream met with; losses, not errors.

    Attributes:
        num_expected: Packets of the complete stream.
        num_missing: Expected packets of which no good copy was there (a packet that was there only in a damaged form
            is missing and corrupt).
        num_corrupt: Files or stretches of bytes that failed their checksum, were cut, misnamed, newer, or not part of
            the manifest's plan.
        num_foreign: Intact packets of other streams.
        num_duplicate: Further copies of packets that were already there.
        problems: One line for each of the above except missing packets, at most 100.
    """

    num_expected: int
    num_missing: int
    num_corrupt: int = 0
    num_foreign: int = 0
    num_duplicate: int = 0
    problems: tuple[str, ...] = ()

    @property
    def num_received(self) -> int:
        """Good packets."""
        return self.num_expected - self.num_missing

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings and lists only."""
        return {**asdict(self), "problems": list(self.problems)}

    @property
    def complete(self) -> bool:
        """Whether every packet is there."""
        return self.num_missing == 0

    @property
    def damage(self) -> str | None:
        """Description of damaged and foreign bytes; None if there are none.

        Missing packets are no damage: a channel loses packets and leaves the others intact. Neither are copies.
        """
        counts = ((self.num_corrupt, "damaged"), (self.num_foreign, "of another stream"))
        found = [f"{count:,} packets or stretches of bytes are {kind}" for count, kind in counts if count]
        if not found:
            return None
        first = next((problem for problem in self.problems if not problem.endswith(ALREADY_THERE)), "")
        return f"{', '.join(found)} (the first: {first})" if first else ", ".join(found)


class PacketIntake:
    """Collects the good packets of one stream out of whatever bytes arrive, in any thread.

    One is enough for a process: what passed it is known by being the very object that it gave back.

    Args:
        manifest: The stream that is being read.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._lock = threading.Lock()
        self._plan = manifest.plan
        self._packets: dict[PacketId, Packet] = {}
        self._firsts: dict[int, list[int]] = {}
        self._counts = {"corrupt": 0, "foreign": 0, "duplicate": 0}
        self._problems: list[str] = []

    def extend(self, manifest: Manifest) -> None:
        """Goes on with the manifest of the same stream that has grown: what passed stays."""
        with self._lock:
            self._manifest, self._plan = manifest, manifest.plan

    @property
    def packets(self) -> tuple[Packet, ...]:
        """The good packets so far, ascending by id."""
        with self._lock:
            return tuple(self._packets[key] for key in sorted(self._packets))

    def has(self, packet: Packet) -> bool:
        """Whether this packet, not only one of its name, passed."""
        return self._packets.get(packet.id) is packet

    @property
    def num_corrupt(self) -> int:
        """Damaged packets so far."""
        return self._counts["corrupt"]

    def offer(self, data: bytes | memoryview, source: str, expected: PacketId | None = None) -> Packet | None:
        """Takes one packet, or counts it and says why not.

        Args:
            data: Bytes that should be exactly one packet.
            source: Where they are from, for the report.
            expected: The packet they should be, if the source says so.

        Returns:
            The packet if it was taken, else None.
        """
        try:
            packet = packet_from_bytes(data, self._manifest.stream_id)
            if expected is not None and packet.id != expected:
                raise CorruptPacketError(expected.filename, f"it holds {packet.id.filename}")
        except ForeignPacketError as error:
            self.count("foreign", f"{source}: {error}")
        except BitstreamError as error:
            self.count("corrupt", f"{source}: {error}")
        else:
            return self.take(packet, source)
        return None

    def take(self, packet: Packet, source: str) -> Packet | None:
        """Takes a packet that was read already, if the manifest's plan has it and it is new.

        Args:
            packet: A packet of this stream.
            source: Where it is from, for the report.

        Returns:
            The packet if it was taken, else None.
        """
        try:
            with self._lock:
                self._check(packet)
                if packet.id not in self._packets:
                    self._packets[packet.id] = packet
                    return packet
        except CorruptPacketError as error:
            self.count("corrupt", f"{source}: {error}")
        else:
            self.count("duplicate", f"{source}: {packet.id.filename} {ALREADY_THERE}")
        return None

    def count(self, kind: str, problem: str) -> None:
        """Counts a loss of a kind: `corrupt`, `foreign` or `duplicate`."""
        with self._lock:
            self._counts[kind] += 1
            if len(self._problems) < MAX_PROBLEMS:
                self._problems.append(problem)

    def _check(self, packet: Packet) -> None:
        """Refuses what the plan has no place for.

        Raises:
            CorruptPacketError: If it has none.
        """
        if not self._plan.fits(packet.id, packet.num_elements):
            count = self._plan.count(packet.id)
            what = f"it holds {packet.num_elements} elements where the manifest's plan has {count}"
            raise CorruptPacketError(packet.id.filename, what)
        if self._plan.packetization.hashed:
            self._check_hashed(packet)

    def _check_hashed(self, packet: Packet) -> None:
        """A packet may not be too large, nor claim elements that another packet of its block already holds."""
        if packet.num_bytes > self._plan.packetization.packet_bytes:
            raise CorruptPacketError(
                packet.id.filename, f"it has {packet.num_bytes} bytes, more than a packet may have"
            )
        firsts = self._firsts.setdefault(packet.id.block, [])
        at, first = bisect.bisect_left(firsts, packet.id.lane), packet.id.lane
        before = self._packets[PacketId(packet.id.block, firsts[at - 1])] if at else None
        if at < len(firsts) and firsts[at] == first:
            if self._packets[packet.id].num_elements != packet.num_elements:
                raise CorruptPacketError(packet.id.filename, "it is another packet than the one that was already there")
            return
        overlaps = before is not None and before.id.lane + before.num_elements > first
        if overlaps or (at < len(firsts) and first + packet.num_elements > firsts[at]):
            raise CorruptPacketError(packet.id.filename, "it holds elements of a packet that was already there")
        if len(self._packets) >= self._manifest.num_packets:
            raise CorruptPacketError(packet.id.filename, "the stream has no further packet")
        firsts.insert(at, first)

    def report(self) -> ReadReport:
        """The counts so far."""
        expected = self._manifest.num_packets
        return ReadReport(
            num_expected=expected,
            # A lying manifest may announce fewer packets than its own plan has; they all fit the plan, so they count.
            num_missing=max(0, expected - len(self._packets)),
            num_corrupt=self._counts["corrupt"],
            num_foreign=self._counts["foreign"],
            num_duplicate=self._counts["duplicate"],
            problems=tuple(self._problems),
        )
