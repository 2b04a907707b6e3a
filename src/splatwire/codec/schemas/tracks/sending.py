"""In which order the packets of a group leave."""

from collections import Counter
from collections.abc import Mapping, Sequence

from splatwire.packets import Packet, PacketId


def dearest_first(packets: Sequence[Packet], worth: Mapping[PacketId, float]) -> list[Packet]:
    """What is seen most first."""
    return sorted(packets, key=lambda packet: -worth[packet.id])


def by_turns(packets: Sequence[Packet], worth: Mapping[PacketId, float]) -> list[Packet]:
    """Of each block the packet in which most is seen, then the next of each.

    What lacks is told by neighbours, and a block is a region: one whose packets all came last would have none that
    tell, however little is seen of it.
    """
    turns, taken, ordered = dict[PacketId, int](), Counter[int](), dearest_first(packets, worth)
    for packet in ordered:
        turns[packet.id] = taken[packet.id.block]
        taken[packet.id.block] += 1
    return sorted(ordered, key=lambda packet: turns[packet.id])
