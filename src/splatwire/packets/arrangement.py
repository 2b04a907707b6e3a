"""Which elements arrived: all elements of a stream, packet by packet, with the gaps that missing packets leave."""

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.packets.packet import Packet
from splatwire.packets.packet_id import PacketId
from splatwire.packets.plan import PacketGroups, PacketPlan


class Arrangement(NamedTuple):
    """All elements of a stream in groups that arrived or did not.

    Attributes:
        groups: Every rank once, group after group.
        packets: The packet of each group (with separated packaging all its packets, one after another); None where it
            did not arrive. With hashed grouping such a gap may stand for several packets: nobody who did not see them
            knows how many.
    """

    groups: PacketGroups
    packets: tuple[Packet | None, ...]


def arrange(plan: PacketPlan, packets: Iterable[Packet]) -> Arrangement:
    """Finds the elements of packets, and the gaps between them.

    Args:
        plan: The stream's plan.
        packets: What arrived, in any order.

    Returns:
        Groups in the order of the complete stream: by block, then lane or position.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two hold the same element.
    """
    arrived = _fitting(plan, packets)
    if not plan.packetization.hashed:
        return Arrangement(plan.groups(), tuple(arrived.get(packet_id) for packet_id in plan.ids))
    pieces = list(_pieces(plan, arrived))
    starts = np.cumsum([0, *(size for size, _ in pieces)]).astype(np.int64)
    return Arrangement(PacketGroups(plan.groups().ranks, starts), tuple(packet for _, packet in pieces))


class ArrivedBlock(NamedTuple):
    """What arrived of a block.

    Attributes:
        number: The block.
        ranks: All of its ranks, as `PacketPlan.block_ranks` gives them.
        packets: Its packets that are there, ascending by id.
        runs: For each of them, where in `ranks` its own are.
    """

    number: int
    ranks: np.ndarray
    packets: tuple[Packet, ...]
    runs: tuple[slice, ...]

    @property
    def counts(self) -> np.ndarray:
        """Elements of each packet, int64."""
        return np.array([packet.num_elements for packet in self.packets], dtype=np.int64)

    @property
    def payloads(self) -> list[bytes]:
        """Payload of each packet."""
        return [packet.payload for packet in self.packets]

    @property
    def received(self) -> np.ndarray:
        """Which of `ranks` a packet holds, bool."""
        there = np.zeros(len(self.ranks), dtype=np.bool_)
        for run in self.runs:
            there[run] = True
        return there


def arrived_blocks(plan: PacketPlan, packets: Iterable[Packet], *, gaps: bool = False) -> Iterator[ArrivedBlock]:
    """Finds the elements of packets, a block at a time, ascending.

    Args:
        plan: The stream's plan.
        packets: What arrived, in any order.
        gaps: Whether blocks of which nothing arrived are listed, too; else they take neither time nor memory.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two hold the same element.
    """
    arrived, after = _fitting(plan, packets), 0
    for block, names in groupby(sorted(arrived), key=lambda packet_id: packet_id.block):
        if gaps:
            yield from (ArrivedBlock(gap, plan.block_ranks(gap), (), ()) for gap in range(after, block))
        after = block + 1
        here = tuple(arrived[packet_id] for packet_id in names)
        runs = tuple(plan.run(packet.id, packet.num_elements) for packet in here)
        for packet, run, following in zip(here[1:], runs, runs[1:], strict=False):
            if plan.packetization.hashed and following.start < run.stop:
                raise InvalidValueError(f"{packet.id.filename} holds elements of the packet before it")
        yield ArrivedBlock(block, plan.block_ranks(block), here, runs)
    if gaps:
        yield from (ArrivedBlock(gap, plan.block_ranks(gap), (), ()) for gap in range(after, plan.num_blocks))


def _fitting(plan: PacketPlan, packets: Iterable[Packet]) -> dict[PacketId, Packet]:
    arrived = {packet.id: packet for packet in packets}
    for packet in arrived.values():
        if not plan.fits(packet.id, packet.num_elements):
            raise InvalidValueError(f"the plan has no packet {packet.id.filename} with {packet.num_elements} elements")
    return arrived


def _pieces(plan: PacketPlan, arrived: dict[PacketId, Packet]) -> Iterator[tuple[int, Packet | None]]:
    """Sizes of packets and gaps, block by block; together they are all elements."""
    ordered = sorted(arrived)
    at = 0
    for block in range(plan.num_blocks):
        position, end = 0, plan.block_elements(block)
        while at < len(ordered) and ordered[at].block == block:
            packet = arrived[ordered[at]]
            if packet.id.lane < position:
                raise InvalidValueError(f"{packet.id.filename} holds elements of the packet before it")
            if packet.id.lane > position:
                yield packet.id.lane - position, None
            yield packet.num_elements, packet
            position, at = packet.id.lane + packet.num_elements, at + 1
        if position < end:
            yield end - position, None
