"""Which anchors arrived: all anchors of a stream, packet by packet, with the gaps that missing packets leave."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.packets.packet import Packet
from splatwire.packets.packet_id import PacketId
from splatwire.packets.plan import PacketGroups, PacketPlan


class Arrangement(NamedTuple):
    """All anchors of a stream in groups that arrived or did not.

    Attributes:
        groups: Every rank once, group after group.
        packets: The packet of each group (with separated packaging all its packets, one after another); None where it
            did not arrive. With hashed grouping such a gap may stand for several packets: nobody who did not see them
            knows how many.
    """

    groups: PacketGroups
    packets: tuple[Packet | None, ...]


def arrange(plan: PacketPlan, packets: Iterable[Packet]) -> Arrangement:
    """Finds the anchors of packets, and the gaps between them.

    Args:
        plan: The stream's plan.
        packets: What arrived, in any order.

    Returns:
        Groups in the order of the complete stream: by block, then lane or position.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two hold the same anchor.
    """
    starts, groups = arrange_groups(plan, packets)
    return Arrangement(PacketGroups(plan.groups().ranks, starts), groups)


def arrange_groups(plan: PacketPlan, packets: Iterable[Packet]) -> tuple[np.ndarray, tuple[Packet | None, ...]]:
    """As `arrange` without the ranks, which `PacketPlan.block_ranks` gives a block at a time: `starts` and packets."""
    arrived = {packet.id: packet for packet in packets}
    for packet in arrived.values():
        if not plan.fits(packet.id, packet.num_anchors):
            raise InvalidValueError(f"the plan has no packet {packet.id.filename} with {packet.num_anchors} anchors")
    if not plan.packetization.hashed:
        starts = np.concatenate([[0], np.cumsum(plan.group_counts())])
        return starts, tuple(arrived.get(packet_id) for packet_id in plan.ids)
    pieces = list(_pieces(plan, arrived))
    starts = np.cumsum([0, *(size for size, _ in pieces)]).astype(np.int64)
    return starts, tuple(packet for _, packet in pieces)


def _pieces(plan: PacketPlan, arrived: dict[PacketId, Packet]) -> Iterator[tuple[int, Packet | None]]:
    """Sizes of packets and gaps, block by block; together they are all anchors."""
    ordered = sorted(arrived)
    at = 0
    for block in range(plan.num_blocks):
        position, end = 0, plan.block_anchors(block)
        while at < len(ordered) and ordered[at].block == block:
            packet = arrived[ordered[at]]
            if packet.id.lane < position:
                raise InvalidValueError(f"{packet.id.filename} holds anchors of the packet before it")
            if packet.id.lane > position:
                yield packet.id.lane - position, None
            yield packet.num_anchors, packet
            position, at = packet.id.lane + packet.num_anchors, at + 1
        if position < end:
            yield end - position, None
