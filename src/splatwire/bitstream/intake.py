"""Filter for received packets: keeps valid ones and counts rejected ones by reason."""

import bisect
import threading
from dataclasses import asdict, dataclass
from typing import Any

from splatwire.arguments import CheckedFields, checked
from splatwire.bitstream.manifest import Manifest
from splatwire.bitstream.packet import Packet, packet_from_bytes
from splatwire.bitstream.packet_id import PacketId
from splatwire.errors import BitstreamError, CorruptPacketError, ForeignPacketError

MAX_PROBLEMS = 100
"""Maximum number of problem descriptions in a report; counters are not limited."""
ALREADY_THERE = "was already there"
"""End of the message that reports a duplicate packet."""


@dataclass(frozen=True)
class ReadReport(CheckedFields):
    """Numbers of lost and rejected packets found while reading a stream.

    Attributes:
        num_expected: Number of packets of the complete stream.
        num_missing: Number of these packets that were not received intact.
        num_corrupt: Number of damaged packets.
        num_foreign: Number of intact packets of other streams.
        num_duplicate: Number of additional copies of packets.
        problems: One line of text for each rejected packet, at most 100 lines.
    """

    num_expected: int
    num_missing: int
    num_corrupt: int = 0
    num_foreign: int = 0
    num_duplicate: int = 0
    problems: tuple[str, ...] = ()

    @property
    def num_received(self) -> int:
        """Number of different valid packets received."""
        return self.num_expected - self.num_missing

    def to_json(self) -> dict[str, Any]:
        """Returns the report as numbers, strings and lists only."""
        return {**asdict(self), "problems": list(self.problems)}

    @property
    def complete(self) -> bool:
        """True if every packet of the stream was received."""
        return self.num_missing == 0

    @property
    def damage(self) -> str | None:
        """Description of damaged and foreign bytes; None if all bytes were good."""
        counts = ((self.num_corrupt, "damaged"), (self.num_foreign, "of another stream"))
        descriptions = [f"{count:,} packets or stretches of bytes are {kind}" for count, kind in counts if count]
        if not descriptions:
            return None
        first = next((problem for problem in self.problems if not problem.endswith(ALREADY_THERE)), "")
        return f"{', '.join(descriptions)} (the first: {first})" if first else ", ".join(descriptions)


class PacketIntake:
    """Filter that collects the valid packets of one stream from received bytes. Thread-safe.

    Args:
        manifest: Manifest of the stream.
    """

    @checked
    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._lock = threading.Lock()
        self._plan = manifest.plan
        self._packets: dict[PacketId, Packet] = {}
        self._first_elements: dict[int, list[int]] = {}
        self._counts = {"corrupt": 0, "foreign": 0, "duplicate": 0}
        self._problems: list[str] = []

    def extend(self, manifest: Manifest) -> None:
        """Replaces the manifest after a live stream has grown."""
        with self._lock:
            self._manifest, self._plan = manifest, manifest.plan

    @property
    def packets(self) -> tuple[Packet, ...]:
        """Valid packets accepted so far, ascending by id."""
        with self._lock:
            return tuple(self._packets[key] for key in sorted(self._packets))

    def has(self, packet: Packet) -> bool:
        """True if the intake has accepted exactly this packet object."""
        return self._packets.get(packet.id) is packet

    @property
    def num_corrupt(self) -> int:
        """Number of damaged packets so far."""
        return self._counts["corrupt"]

    def add_bytes(self, data: bytes | memoryview, source: str, expected: PacketId | None = None) -> Packet | None:
        """Validates the bytes of a packet and accepts or rejects it.

        Args:
            data: Bytes of exactly one packet.
            source: Source of the bytes, for the report.
            expected: Expected id of the packet, if known.

        Returns:
            The packet if it was accepted, else None.
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
            return self.add(packet, source)
        return None

    def add(self, packet: Packet, source: str) -> Packet | None:
        """Accepts a packet if it fits the manifest and is not a duplicate.

        Args:
            packet: A packet of this stream.
            source: Source of the packet, for the report.

        Returns:
            The packet if it was accepted, else None.
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
        """Counts a rejected packet.

        Args:
            kind: `corrupt`, `foreign` (from a different stream) or `duplicate`.
            problem: One line of text for the report.
        """
        with self._lock:
            self._counts[kind] += 1
            if len(self._problems) < MAX_PROBLEMS:
                self._problems.append(problem)

    def _check(self, packet: Packet) -> None:
        """Checks that the stream's packet plan has a packet with this id and number of elements.

        Raises:
            CorruptPacketError: If the plan has no such packet.
        """
        if not self._plan.fits(packet.id, packet.num_elements):
            count = self._plan.count(packet.id)
            problem = f"it holds {packet.num_elements} elements where the manifest's plan has {count}"
            raise CorruptPacketError(packet.id.filename, problem)
        if self._plan.packetization.hashed:
            self._check_hashed(packet)

    def _check_hashed(self, packet: Packet) -> None:
        """Checks a packet of a stream whose packets are filled up to a size limit (grouping `hashed`).

        Raises:
            CorruptPacketError: If the packet is too large, contains elements of another packet, or is surplus.
        """
        if packet.num_bytes > self._plan.packetization.packet_bytes:
            raise CorruptPacketError(
                packet.id.filename, f"it has {packet.num_bytes} bytes, more than a packet may have"
            )
        firsts = self._first_elements.setdefault(packet.id.block, [])
        index, first = bisect.bisect_left(firsts, packet.id.index_in_block), packet.id.index_in_block
        previous = self._packets[PacketId(packet.id.block, firsts[index - 1])] if index else None
        if index < len(firsts) and firsts[index] == first:
            if self._packets[packet.id].num_elements != packet.num_elements:
                raise CorruptPacketError(packet.id.filename, "it is another packet than the one that was already there")
            return
        overlaps = previous is not None and previous.id.index_in_block + previous.num_elements > first
        if overlaps or (index < len(firsts) and first + packet.num_elements > firsts[index]):
            raise CorruptPacketError(packet.id.filename, "it holds elements of a packet that was already there")
        if len(self._packets) >= self._manifest.num_packets:
            raise CorruptPacketError(packet.id.filename, "the stream has no further packet")
        firsts.insert(index, first)

    def report(self) -> ReadReport:
        """Returns the numbers of received, missing and rejected packets so far."""
        expected = self._manifest.num_packets
        return ReadReport(
            num_expected=expected,
            # A false manifest may announce fewer packets than its plan has; all of them fit the plan and are counted.
            num_missing=max(0, expected - len(self._packets)),
            num_corrupt=self._counts["corrupt"],
            num_foreign=self._counts["foreign"],
            num_duplicate=self._counts["duplicate"],
            problems=tuple(self._problems),
        )
