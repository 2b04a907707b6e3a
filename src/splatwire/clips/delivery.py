"""What of a clip's motion arrives in its time: parity over each group of frames, on a channel that loses datagrams."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from splatwire.channel import LossModel
from splatwire.packets import PacketId, SceneStream, send_sequence
from splatwire.transport.fec import framed_bytes
from splatwire.transport.layout import Group, head_object, parity_groups
from splatwire.transport.motion import Arranged, GroupPackets, arrange, group_packets
from splatwire.transport.protection import Protection
from splatwire.transport.timetable import timetable
from splatwire.transport.wire import DATA, DATA_OVERHEAD, PARITY, PARITY_OVERHEAD

SPARE_SYMBOLS = 1
"""Symbols beyond K that a decoder is counted to need; RaptorQ fails with probability 1e-4 then (RFC 6330, 1)."""


@dataclass(frozen=True, eq=False)
class ClipLoad:
    """Packets of a complete clip in sending order.

    Attributes:
        ids: Their names.
        head_bytes: Manifest and side information.
        packet_bytes: Of each packet on the wire, int64 (P).
        worth: What losing each costs, see `splatwire.clips.worth`, float64 (P).
        groups: Packets of each group of frames.
    """

    ids: tuple[PacketId, ...]
    head_bytes: int
    packet_bytes: np.ndarray
    worth: np.ndarray
    groups: tuple[GroupPackets, ...]

    @staticmethod
    def of(stream: SceneStream, worth: Mapping[PacketId, float]) -> "ClipLoad":
        """The packets of a complete clip."""
        ordered = send_sequence(stream, "tiers")
        return ClipLoad(
            tuple(packet.id for packet in ordered),
            len(head_object(stream.manifest, stream.side_info)),
            np.array([packet.num_bytes + DATA_OVERHEAD for packet in ordered], np.int64),
            np.array([worth[packet.id] for packet in ordered]),
            tuple(group_packets(ordered, stream.manifest.plan)),
        )

    @property
    def parity_bytes(self) -> int:
        """Of a repair symbol on the wire."""
        return framed_bytes(int(self.packet_bytes.max(initial=0)) - DATA_OVERHEAD) + PARITY_OVERHEAD

    @property
    def num_bytes(self) -> int:
        """Bytes of all without parity."""
        return self.head_bytes + int(self.packet_bytes.sum())


@dataclass(frozen=True, eq=False)
class Passage:
    """Packets and parity of some groups of frames, as they leave.

    Attributes:
        order: Packet at each place, int64.
        codes: Places that share a code.
        items: Kind, code and number of each datagram, int64 (n, 3), as `Program.schedule`.
    """

    order: np.ndarray
    codes: tuple[Group, ...]
    items: np.ndarray

    @staticmethod
    def of(found: Arranged, protection: Protection) -> "Passage":
        """The datagrams that arranged packets leave in."""
        codes = tuple(parity_groups(found.tiers))
        timing = replace(protection, parity_until=0.0)
        items = timetable([], found.tiers, [code.repair for code in codes], timing, [len(found.order)])
        return Passage(np.array(found.order, np.int64), codes, np.array(items, np.int64).reshape(-1, 3))

    @property
    def num_parity(self) -> int:
        """Repair symbols."""
        return sum(code.repair for code in self.codes)

    def arrived(self, received: np.ndarray) -> np.ndarray:
        """Which packets are there, bool (T, packets), by their place in `order`.

        Args:
            received: Fate of each datagram in each of T transfers, bool (T, n or more).
        """
        kind, code, number = self.items.T
        here, data = received[:, : len(kind)], kind == DATA
        packets = np.zeros((len(received), len(self.order)), bool)
        packets[:, number[data]] = here[:, data]
        for which, group in enumerate(self.codes):
            members = group.start + group.step * np.arange(group.size)
            parity = here[:, (kind == PARITY) & (code == which)].sum(axis=1)
            enough = packets[:, members].sum(axis=1) + parity >= group.size + SPARE_SYMBOLS * (group.size > 1)
            packets[np.ix_(enough, members)] = True
        return packets


def passage(load: ClipLoad, protection: Protection, group: int | None = None) -> Passage:
    """How a clip leaves, or one of its groups of frames by itself."""
    if group is not None:
        return Passage.of(arrange([load.groups[group]], load.worth.tolist(), protection, group), protection)
    worth = load.worth.tolist()
    found = [arrange([some], worth, protection, number) for number, some in enumerate(load.groups)]
    order = tuple(packet for part in found for packet in part.order)
    return Passage.of(Arranged(order, tuple(tier for part in found for tier in part.tiers)), protection)


def delivered(load: ClipLoad, protection: Protection, loss: LossModel, seed: int) -> set[PacketId]:
    """Packets that are there after one pass of a clip, parity used.

    Args:
        load: The clip.
        protection: Where parity goes.
        loss: What is lost, in datagrams.
        seed: Of the losses.
    """
    whole = passage(load, protection)
    received = loss.received(len(whole.items), np.random.Generator(np.random.PCG64(seed)))
    there = whole.arrived(received[None])[0]
    return {load.ids[packet] for packet in whole.order[there].tolist()}
