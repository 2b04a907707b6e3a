"""Parity of motion packets in sequences: sending order and parity groups for each group of pictures."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from splatwire.bitstream import Packet, PacketPlan
from splatwire.transport.fec import MAX_REPAIR, MAX_SYMBOLS
from splatwire.transport.protocol.messages import MAX_PARITY_RANGES, ParityRange
from splatwire.transport.protocol.protection import Protection

MAX_SETTINGS = (MAX_PARITY_RANGES - 2) // 2
"""Maximum number of parity settings in a sequence; in longer sequences, neighbouring groups of pictures share one."""


class ProtectedOrder(NamedTuple):
    """Sending order and parity of the packets of one or more groups of pictures.

    Attributes:
        order: Indices of the packets in the list before sorting: packet `order[i]` of the list is sent as the i-th
            packet.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
    """

    order: tuple[int, ...]
    parity_ranges: tuple[ParityRange, ...]


class GroupPackets(NamedTuple):
    """Packets of one group of pictures, as indices into a list of packets that are not yet in sending order.

    Attributes:
        keyframes: Indices of the keyframe packets, which later groups also need.
        motion: Indices of the motion packets, which only this group needs.
    """

    keyframes: tuple[int, ...]
    motion: tuple[int, ...]


def group_packets(packets: Sequence[Packet], plan: PacketPlan) -> list[GroupPackets]:
    """Returns the packet indices of each group of pictures of a sequence.

    Args:
        packets: All packets of the sequence, before `order_and_protect` sorts them for sending.
        plan: Packet plan of the manifest: mapping between elements and packets.
    """
    groups = [GroupPackets((), ())] * len(plan.gop_spans)
    packets_by_kind: list[tuple[list[int], list[int]]] = [([], []) for _ in groups]
    for number, packet in enumerate(packets):
        block = packet.id.block
        packets_by_kind[plan.gop_of_block(block)][0 if plan.is_keyframe(block) else 1].append(number)
    return [GroupPackets(tuple(keyframes), tuple(motion)) for keyframes, motion in packets_by_kind]


def order_and_protect(
    groups: Sequence[GroupPackets], importance: Sequence[float] | None, protection: Protection, first: int = 0
) -> ProtectedOrder:
    """Sorts the packets of a sequence for sending, and determines their parity.

    In each group of pictures, keyframe packets come first, then motion packets with parity, then all other motion
    packets. A stream has at most `MAX_SETTINGS` parity settings. If there are more groups of pictures, several
    consecutive groups are sorted like a single group, and share a setting.

    Args:
        groups: Packet indices of consecutive groups of pictures.
        importance: Cost of losing each packet, by packet index. The motion packets with the highest costs get parity.
            None to give parity to the first motion packets.
        protection: Redundancy. `Protection.motion` has the amount of parity for each group of the sequence.
        first: Index of `groups[0]` in the stream; each period of a live sequence is a stream.

    Returns:
        Sending order of the packets, and their parity.
    """
    groups_per_setting = max(-(-len(groups) // MAX_SETTINGS), 1)
    order, ranges = list[int](), list[ParityRange]()
    for begin in range(0, len(groups), groups_per_setting):
        keyframes, protected, others, total_repair = list[int](), list[int](), list[int](), 0.0
        for number, group in enumerate(groups[begin : begin + groups_per_setting], first + begin):
            share, repair = protection.motion_of(number)
            chosen = _most_important(group.motion, importance, _round_up(share * len(group.motion)) if repair else 0)
            keyframes += group.keyframes
            protected += [packet for packet in group.motion if packet in chosen]
            others += [packet for packet in group.motion if packet not in chosen]
            total_repair += repair * len(chosen)
        num_parity_groups = -(-len(protected) // MAX_SYMBOLS)
        num_repair = min(_round_up(total_repair / num_parity_groups), MAX_REPAIR) if num_parity_groups else 0
        order += [*keyframes, *protected, *others]
        ranges += [
            ParityRange(len(keyframes), 0, 0),
            ParityRange(len(protected), num_parity_groups if num_repair else 0, num_repair),
        ]
        ranges.append(ParityRange(len(others), 0, 0))
    return ProtectedOrder(tuple(order), _joined(ranges))


def _round_up(share: float) -> int:
    """Rounds up to an integer. A fraction of at most 1e-9 may be a floating-point error and is rounded down."""
    # Without the tolerance, 0.07 * 100 packets would be rounded up to 8.
    return math.ceil(share - 1e-9)


def _most_important(motion: Sequence[int], importance: Sequence[float] | None, count: int) -> set[int]:
    if importance is None:
        return set(motion[:count])
    return set(sorted(motion, key=lambda packet: -importance[packet])[:count])


def _joined(ranges: Sequence[ParityRange]) -> tuple[ParityRange, ...]:
    """Merges adjacent ranges that have no parity, and removes ranges that contain no packet.

    Args:
        ranges: Consecutive ranges of packets, with their parity.
    """
    out = list[ParityRange]()
    for parity_range in ranges:
        if parity_range.num_packets and out and not (parity_range.groups or out[-1].groups):
            out[-1] = ParityRange(out[-1].num_packets + parity_range.num_packets, 0, 0)
        elif parity_range.num_packets:
            out.append(parity_range)
    return tuple(out) or (ParityRange(0, 0, 0),)
