"""In which order the packets of a stream are sent."""

from splatwire.errors import UnknownNameError
from splatwire.packets.packet import Packet
from splatwire.packets.scene_stream import SceneStream

SEND_ORDERS = ("interleaved", "block", "tiers")


def send_sequence(stream: SceneStream, send_order: str) -> list[Packet]:
    """Packets of a stream in the order in which they are sent.

    Args:
        stream: The stream, complete or not.
        send_order: `interleaved`: lane 0 (or the first hash positions) of all blocks, then lane 1, ..., so that a burst
            takes packets of different blocks; `block`: all lanes of block 0, then block 1, ..., where a burst can wipe
            out a block; `tiers`: as `interleaved`, but all of the more important tier before the next one, which
            is what becomes of `interleaved` where elements come in time. Tiles (`StreamSchema.tiled`) are sent one by
            one, as `block`.

    Raises:
        UnknownNameError: If there is no such order.
    """
    if send_order not in SEND_ORDERS:
        raise UnknownNameError("send order", send_order, SEND_ORDERS)
    if send_order == "block" or (send_order == "tiers" and stream.manifest.schema.tiled):
        return list(stream.packets)
    plan, timed = stream.manifest.plan, stream.manifest.schema.timed
    tier_of = [plan.tier_of(block) if timed or send_order == "tiers" else 0 for block in range(plan.num_blocks)]
    return sorted(stream.packets, key=lambda p: (tier_of[p.id.block], p.id.lane, p.id.part, p.id.block))
