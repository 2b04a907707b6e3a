"""Sending order of the packets of a stream."""

from splatwire.arguments import checked
from splatwire.bitstream.packet import Packet
from splatwire.bitstream.scene_stream import SceneStream
from splatwire.errors import UnknownNameError

SEND_ORDERS = ("interleaved", "block", "tiers")


@checked
def send_sequence(stream: SceneStream, send_order: str) -> list[Packet]:
    """Returns the packets of a stream in sending order.

    Args:
        stream: The stream, complete or not.
        send_order: One of these orders. `interleaved`: lane 0 (or the first hash positions) of all blocks, then lane 1
            and further; a burst loss hits packets of different blocks. `block`: all lanes of block 0, then block 1 and
            further; a burst loss can remove a whole block. `tiers`: most important tier first; the order within each
            tier is `interleaved`. Sequences always use `tiers` in place of `interleaved`. Tiled streams
            (`StreamSchema.tiled`) use `block` in place of `tiers`.

    Raises:
        UnknownNameError: If the order is unknown.
    """
    if send_order not in SEND_ORDERS:
        raise UnknownNameError("send order", send_order, SEND_ORDERS)
    if send_order == "block" or (send_order == "tiers" and stream.manifest.schema.tiled):
        return list(stream.packets)
    plan, timed = stream.manifest.plan, stream.manifest.schema.timed
    tier_of = [plan.tier_of(block) if timed or send_order == "tiers" else 0 for block in range(plan.num_blocks)]
    return sorted(stream.packets, key=lambda p: (tier_of[p.id.block], p.id.lane, p.id.part, p.id.block))
