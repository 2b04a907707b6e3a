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
        send_order: One of these names:

            * `interleaved`: the first packet of every block, then the second packet of every block, and so on. A
              sequence is interleaved within the keyframe Gaussians and within the motion of each group of pictures.
            * `block`: all packets of block 0, then of block 1, and so on.
            * `tiers`: the most important tier first, and interleaved within a tier. For levels of detail, as `block`.

    Raises:
        UnknownNameError: If the order is unknown.
    """
    if send_order not in SEND_ORDERS:
        raise UnknownNameError("send order", send_order, SEND_ORDERS)
    if send_order == "block" or (send_order == "tiers" and stream.manifest.schema.tiled):
        return list(stream.packets)
    plan, timed = stream.manifest.plan, stream.manifest.schema.timed
    tier_of = [plan.tier_of(block) if timed or send_order == "tiers" else 0 for block in range(plan.num_blocks)]
    return sorted(stream.packets, key=lambda p: (tier_of[p.id.block], p.id.index_in_block, p.id.part, p.id.block))
