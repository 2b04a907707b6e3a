"""Sending order of the packets of a group of frames."""

from collections import Counter
from collections.abc import Mapping, Sequence

from splatwire.bitstream import Packet, PacketId


def by_importance(packets: Sequence[Packet], importance: Mapping[PacketId, float]) -> list[Packet]:
    """Returns the packets sorted by decreasing importance.

    Args:
        packets: The packets.
        importance: Importance of each packet, by packet id.
    """
    return sorted(packets, key=lambda packet: -importance[packet.id])


def interleave_blocks(packets: Sequence[Packet], importance: Mapping[PacketId, float]) -> list[Packet]:
    """Sorts packets for sending: round robin over the blocks, most important packets of each block first.

    Args:
        packets: The packets.
        importance: Importance of each packet, by packet id.
    """
    turns, taken, ordered = dict[PacketId, int](), Counter[int](), by_importance(packets, importance)
    for packet in ordered:
        turns[packet.id] = taken[packet.id.block]
        taken[packet.id.block] += 1
    # Lost tracks are concealed from neighbours in their block. If a transfer ends early, each block has received some
    # packets.
    return sorted(ordered, key=lambda packet: turns[packet.id])
