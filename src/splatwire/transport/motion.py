"""Parity for what moves: which packets of a group of frames share a code, and in which order they leave."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from splatwire.packets import Packet, PacketPlan
from splatwire.transport.fec import MAX_REPAIR, MAX_SYMBOLS
from splatwire.transport.frames import MAX_TIERS, TierHead
from splatwire.transport.protection import Protection

MOST_CODES = (MAX_TIERS - 2) // 2
"""Groups of frames with a code of their own: of a recorded clip that has more, some neighbours share one."""


class Arranged(NamedTuple):
    """Packets of groups of frames as they leave.

    Attributes:
        order: Number of each packet, in sending order.
        tiers: Their runs: bases of a group, motion that shares a code, motion that has none.
    """

    order: tuple[int, ...]
    tiers: tuple[TierHead, ...]


class GroupPackets(NamedTuple):
    """Numbers of the packets of a group of frames: what lasts, and what its tracks do."""

    bases: tuple[int, ...]
    motion: tuple[int, ...]


def group_packets(packets: Sequence[Packet], plan: PacketPlan) -> list[GroupPackets]:
    """Sorts packets of a clip, in sending order, by the group of frames that they are of."""
    groups = [GroupPackets((), ())] * (len(plan.spans) // 2)
    found: list[tuple[list[int], list[int]]] = [([], []) for _ in groups]
    for number, packet in enumerate(packets):
        tier = plan.tier_of(packet.id.block)
        found[tier // 2][tier % 2].append(number)
    return [GroupPackets(tuple(bases), tuple(motion)) for bases, motion in found]


def arrange(
    groups: Sequence[GroupPackets], worth: Sequence[float] | None, protection: Protection, first: int = 0
) -> Arranged:
    """Puts the packets of each group in order: bases, motion that is protected, other motion.

    Args:
        groups: They, consecutive ones.
        worth: What losing each packet costs, by its number; of a group the dearest are protected. None: all alike.
        protection: How much of the motion is protected, and by how much.
        first: Number of the first of the groups.
    """
    together = max(-(-len(groups) // MOST_CODES), 1)
    order, tiers = list[int](), list[TierHead]()
    for begin in range(0, len(groups), together):
        bases, coded, others, repair = list[int](), list[int](), list[int](), 0.0
        for number, group in enumerate(groups[begin : begin + together], first + begin):
            share, most = protection.motion_of(number)
            chosen = _dearest(group.motion, worth, _whole(share * len(group.motion)) if most else 0)
            bases += group.bases
            coded += [packet for packet in group.motion if packet in chosen]
            others += [packet for packet in group.motion if packet not in chosen]
            repair += most * len(chosen)
        codes = -(-len(coded) // MAX_SYMBOLS)
        symbols = min(_whole(repair / codes), MAX_REPAIR) if codes else 0
        order += [*bases, *coded, *others]
        tiers += [TierHead(len(bases), 0, 0), TierHead(len(coded), codes if symbols else 0, symbols)]
        tiers.append(TierHead(len(others), 0, 0))
    return Arranged(tuple(order), _joined(tiers))


def _whole(share: float) -> int:
    """The next whole number: of a few packets one is protected, by one symbol."""
    return math.ceil(share - 1e-9)


def _dearest(motion: Sequence[int], worth: Sequence[float] | None, count: int) -> set[int]:
    if worth is None:
        return set(motion[:count])
    return set(sorted(motion, key=lambda packet: -worth[packet])[:count])


def _joined(tiers: Sequence[TierHead]) -> tuple[TierHead, ...]:
    """Neighbouring runs without parity in one, empty ones left out."""
    out = list[TierHead]()
    for tier in tiers:
        if tier.num_packets and out and not (tier.groups or out[-1].groups):
            out[-1] = TierHead(out[-1].num_packets + tier.num_packets, 0, 0)
        elif tier.num_packets:
            out.append(tier)
    return tuple(out) or (TierHead(0, 0, 0),)
