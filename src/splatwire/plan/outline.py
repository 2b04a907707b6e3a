"""A transfer in numbers: what is sent when and how large it is, without the bytes; and what of it arrives.

The planner compares hundreds of protections. Making each one's repair symbols would take minutes, counting takes none.
"""

from dataclasses import dataclass

import numpy as np

from splatwire.channel import LossModel
from splatwire.packets import SceneStream, send_sequence
from splatwire.transport.fec import MAX_REPAIR, framed_bytes
from splatwire.transport.layout import Group, Segments, carried_bytes, head_object, parity_groups
from splatwire.transport.program import side_symbol_bytes
from splatwire.transport.protection import Protection, carried_packets, packets_in_tiers, protected_tiers
from splatwire.transport.timetable import timetable
from splatwire.transport.wire import DATA, DATA_OVERHEAD, PARITY, PARITY_OVERHEAD, SIDE, SIDE_OVERHEAD

SYMBOLS_TO_SPARE = 1
"""Symbols beyond K that a decoder is counted to need; RaptorQ fails with probability 1e-4 then (RFC 6330, 1)."""


@dataclass(frozen=True, eq=False)
class StreamLoad:
    """Sizes of a stream's packets, in sending order.

    Attributes:
        head_bytes: Manifest and side information.
        packet_bytes: Bytes of each packet, int64 (P).
        elements: Elements of each packet, int64 (P).
        tiers: Tier of importance of each packet, int64 (P), ascending.
    """

    head_bytes: int
    packet_bytes: np.ndarray
    elements: np.ndarray
    tiers: np.ndarray

    @property
    def num_tiers(self) -> int:
        """Tiers of importance."""
        return int(self.tiers.max(initial=0)) + 1

    @staticmethod
    def of_stream(stream: SceneStream) -> "StreamLoad":
        """Sizes of a complete stream."""
        ordered, plan = send_sequence(stream, "tiers"), stream.manifest.plan
        return StreamLoad(
            len(head_object(stream.manifest, stream.side_info)),
            np.array([packet.num_bytes for packet in ordered], dtype=np.int64),
            np.array([packet.num_elements for packet in ordered], dtype=np.int64),
            np.array([plan.tier_of(packet.id.block) for packet in ordered], dtype=np.int64),
        )


@dataclass(frozen=True, eq=False)
class Outline:
    """One pass of a transfer, datagram by datagram.

    Attributes:
        kind: `SIDE`, `DATA` or `PARITY`, int64 (n).
        group: Segment of the head object or parity group; 0 for a packet, int64 (n).
        symbol: Number of the symbol in it, or place of the packet, int64 (n).
        num_bytes: Size of each datagram, headers included, int64 (n).
        head: Source symbols of each segment of the head object.
        groups: The parity groups.
        num_packets: Packets of the stream.
        carried: How many of them are in the head object, the first ones.
    """

    kind: np.ndarray
    group: np.ndarray
    symbol: np.ndarray
    num_bytes: np.ndarray
    head: tuple[int, ...]
    groups: tuple[Group, ...]
    num_packets: int
    carried: int = 0

    def bytes_by_kind(self) -> dict[str, int]:
        """Bytes of one complete pass, as `Program.sizes`."""
        repair = (self.kind == SIDE) & (self.symbol >= np.array(self.head, dtype=np.int64)[self._segment()])
        masks = {"side": (self.kind == SIDE) & ~repair, "side_protection": repair, "packets": self.kind == DATA,
                 "packet_protection": self.kind == PARITY}  # fmt: skip
        return {name: int(self.num_bytes[mask].sum()) for name, mask in masks.items()}

    def sent_within(self, budget_bytes: float | int) -> int:
        """Datagrams that leave before a budget is spent."""
        return int(np.searchsorted(np.cumsum(self.num_bytes), budget_bytes, side="right"))

    def _segment(self) -> np.ndarray:
        return np.where(self.kind == SIDE, self.group, 0)


def outline_transfer(load: StreamLoad, protection: Protection) -> Outline:
    """Lays out a transfer.

    Args:
        load: The stream.
        protection: Where redundancy goes.

    Raises:
        InvalidValueError: If the protection does not fit the stream.
    """
    carried = carried_packets(len(load.packet_bytes), protection)
    head_bytes = load.head_bytes + carried_bytes(int(load.packet_bytes[:carried].sum()), carried)
    symbol_bytes = protection.side_symbol_bytes or side_symbol_bytes(head_bytes)
    segments = Segments(head_bytes, symbol_bytes)
    head = tuple(segments.size(s) for s in range(segments.num_segments))
    with_repair = [size + min(round(protection.side_repair * size), MAX_REPAIR) for size in head]
    members = load.tiers.tolist()
    tiers = protected_tiers(members, protection)
    groups = tuple(parity_groups(tiers))
    items = timetable(
        with_repair, tiers, [group.repair for group in groups], protection, packets_in_tiers(members, protection)
    )
    table = np.array(items, dtype=np.int64).reshape(-1, 3)
    parity_bytes = framed_bytes(int(load.packet_bytes.max(initial=0))) + PARITY_OVERHEAD
    size = np.where(table[:, 0] == SIDE, symbol_bytes + SIDE_OVERHEAD, parity_bytes)
    data = table[:, 0] == DATA
    size[data] = load.packet_bytes[table[data, 2]] + DATA_OVERHEAD
    return Outline(table[:, 0], table[:, 1], table[:, 2], size, head, groups, len(load.packet_bytes), carried)


@dataclass(frozen=True, eq=False)
class Deliveries:
    """What T transfers deliver.

    Attributes:
        head: Whether manifest and side information can be read, bool (T).
        packets: Which packets are there, received, recovered or in the head object (whether it arrived or not), bool
            (T, P), in sending order.
    """

    head: np.ndarray
    packets: np.ndarray


def simulate(outline: Outline, received: np.ndarray) -> Deliveries:
    """Counts what arrives and what the codes bring back.

    Args:
        outline: The transfer.
        received: Which datagrams arrive in each of T transfers, bool (T, n).
    """
    head, trials = head_arrives(outline, received), len(received)
    packets = np.zeros((trials, outline.num_packets), dtype=np.bool_)
    data = outline.kind == DATA
    packets[:, outline.symbol[data]] = received[:, data]
    packets[:, : outline.carried] = True
    for number, group in enumerate(outline.groups):
        members = group.start + group.step * np.arange(group.size)
        parity = received[:, (outline.kind == PARITY) & (outline.group == number)].sum(axis=1)
        enough = packets[:, members].sum(axis=1) + parity >= group.size + SYMBOLS_TO_SPARE
        packets[np.ix_(enough, members)] = True
    return Deliveries(head, packets)


def head_arrives(outline: Outline, received: np.ndarray) -> np.ndarray:
    """Whether manifest and side information can be read in each of T transfers, bool (T); see `simulate`."""
    head = np.ones(len(received), dtype=np.bool_)
    for segment, size in enumerate(outline.head):
        mine = (outline.kind == SIDE) & (outline.group == segment)
        here = received[:, mine]
        all_sources = here[:, outline.symbol[mine] < size].all(axis=1)
        head &= all_sources | (here.sum(axis=1) >= size + SYMBOLS_TO_SPARE)
    return head


def draw_losses(loss: LossModel, trials: int, num_datagrams: int, seed: int) -> np.ndarray:
    """Fates of the datagrams of some transfers, True where one arrives, bool (trials, num_datagrams)."""
    rngs = (np.random.Generator(np.random.PCG64([seed, trial])) for trial in range(trials))
    return np.stack([loss.received(num_datagrams, rng) for rng in rngs])
