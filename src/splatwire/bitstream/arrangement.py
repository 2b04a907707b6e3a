"""Finds which elements (anchors or Gaussians) of a stream were received and which were lost."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream.packet import Packet
from splatwire.bitstream.packet_id import PacketId
from splatwire.bitstream.plan import PacketMembers, PacketPlan
from splatwire.errors import InvalidValueError
from splatwire.reprs import summary_repr


class PacketAssignment(NamedTuple):
    """Assignment of a stream's elements (anchors or Gaussians) to packets, with the received packets.

    Attributes:
        members: Elements of each packet.
        packets: Packets in the order of `members`; None for a lost packet. Each entry of `members` has one packet, or
            one packet per attribute if attributes have separate packets.
    """

    members: PacketMembers
    packets: tuple[Packet | None, ...]


@checked
def assign_packets(plan: PacketPlan, packets: Iterable[Packet]) -> PacketAssignment:
    """Assigns each element of a stream to its received packet, or to a gap if its packet is lost.

    Args:
        plan: Packet plan of the stream.
        packets: Received packets, in any order.

    Returns:
        All elements of the complete stream, in the order of its packets.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two contain the same element.
    """
    arrived = _fitting(plan, packets)
    if not plan.packetization.hashed:
        return PacketAssignment(plan.all_members(), tuple(arrived.get(packet_id) for packet_id in plan.ids))
    pieces = list(_received_and_missing(plan, arrived))
    starts = np.cumsum([0, *(size for size, _ in pieces)]).astype(np.int64)
    return PacketAssignment(PacketMembers(plan.all_members().indices, starts), tuple(packet for _, packet in pieces))


@dataclass(frozen=True, eq=False)
class PacketBatch:
    """Received packets that a decoder processes together, such as all packets of one spatial block.

    Attributes:
        block: Index of the block of the first packet.
        packets: The packets, ascending by id.
        members: For each packet, the indices of its elements, int64. In batches from `arrived_blocks`, they count in
            plan order (see `PacketPlan`). In batches for decoders, they count in the decoded scene (`Decoder.order`).
    """

    block: int
    packets: tuple[Packet, ...]
    members: tuple[np.ndarray, ...]

    __repr__ = summary_repr

    @property
    def indices(self) -> np.ndarray:
        """Indices of the elements of all packets, packet after packet: the arrays of `members` concatenated, int64."""
        return np.concatenate([np.empty(0, dtype=np.int64), *self.members])

    @property
    def counts(self) -> np.ndarray:
        """Number of elements in each packet, int64 (packets)."""
        return np.array([packet.num_elements for packet in self.packets], dtype=np.int64)

    @property
    def payloads(self) -> list[bytes]:
        """Payload bytes of each packet."""
        return [packet.payload for packet in self.packets]


@checked
def arrived_blocks(plan: PacketPlan, packets: Iterable[Packet], *, gaps: bool = False) -> Iterator[PacketBatch]:
    """Yields the received packets of one spatial block at a time, with their elements.

    Args:
        plan: Packet plan of the stream.
        packets: Received packets, in any order.
        gaps: True to also yield blocks without received packets.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two contain the same element.
    """
    arrived, after = _fitting(plan, packets), 0
    for block, ids in groupby(sorted(arrived), key=lambda packet_id: packet_id.block):
        if gaps:
            yield from (PacketBatch(gap, (), ()) for gap in range(after, block))
        after = block + 1
        packets_of_block = tuple(arrived[packet_id] for packet_id in ids)
        slices = tuple(plan.packet_slice(packet.id, packet.num_elements) for packet in packets_of_block)
        for packet, before, following in zip(packets_of_block[1:], slices, slices[1:], strict=False):
            if plan.packetization.hashed and following.start < before.stop:
                raise InvalidValueError(f"{packet.id.filename} holds elements of the packet before it")
        indices = plan.block_indices(block)
        yield PacketBatch(block, packets_of_block, tuple(indices[members] for members in slices))
    if gaps:
        yield from (PacketBatch(gap, (), ()) for gap in range(after, plan.num_blocks))


def _fitting(plan: PacketPlan, packets: Iterable[Packet]) -> dict[PacketId, Packet]:
    arrived = {packet.id: packet for packet in packets}
    for packet in arrived.values():
        if not plan.fits(packet.id, packet.num_elements):
            raise InvalidValueError(f"the plan has no packet {packet.id.filename} with {packet.num_elements} elements")
    return arrived


def _received_and_missing(plan: PacketPlan, arrived: dict[PacketId, Packet]) -> Iterator[tuple[int, Packet | None]]:
    """Divides the elements (anchors or Gaussians) of a stream into received packets and the gaps between them.

    This function serves plans with the grouping `hashed`, in which packets are filled up to a size limit. The number
    of lost packets in a gap is therefore unknown.

    Args:
        plan: Packet plan of the stream, with the grouping `hashed`.
        arrived: Received packets, by id.

    Yields:
        Pairs that together cover all elements, in the order of `PacketPlan.all_members`. The pair of a received packet
        is its number of elements, and the packet. The pair of a gap is the number of missing elements, and None.

    Raises:
        InvalidValueError: If two packets contain the same element.
    """
    ordered = sorted(arrived)
    index = 0
    for block in range(plan.num_blocks):
        position, end = 0, plan.block_elements(block)
        while index < len(ordered) and ordered[index].block == block:
            packet = arrived[ordered[index]]
            if packet.id.index_in_block < position:
                raise InvalidValueError(f"{packet.id.filename} holds elements of the packet before it")
            if packet.id.index_in_block > position:
                yield packet.id.index_in_block - position, None
            yield packet.num_elements, packet
            position, index = packet.id.index_in_block + packet.num_elements, index + 1
        if position < end:
            yield end - position, None
