"""Packets: which elements share one, what its bytes are, and streams on disk. numpy and the standard library only."""

from splatwire.packets.arrangement import Arrangement, ArrivedBlock, arrange, arrived_blocks
from splatwire.packets.container import file_head, file_record, stream_from_bytes, stream_to_bytes
from splatwire.packets.intake import PacketIntake, ReadReport
from splatwire.packets.limits import ANCHORS, CAUSAL, COLUMNS, GAUSSIANS
from splatwire.packets.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.packets.packet import HEADER_BYTES, Packet, make_packet, packet_from_bytes
from splatwire.packets.packet_id import PARTS, PacketId
from splatwire.packets.packetization import (
    PRESETS,
    Packetization,
    packetization_named,
    spread_packetization,
)
from splatwire.packets.plan import PacketGroups, PacketPlan
from splatwire.packets.scene_stream import SceneStream, make_stream, make_stream_id
from splatwire.packets.send_order import SEND_ORDERS, send_sequence
from splatwire.packets.sizes import StreamSizes, measure_sizes
from splatwire.packets.splitmix64 import splitmix64
from splatwire.packets.stream import is_stream, read_stream, write_stream
from splatwire.packets.tiers import TierShape, shape_tiers, tier_order

__all__ = [
    "ANCHORS",
    "CAUSAL",
    "COLUMNS",
    "GAUSSIANS",
    "HEADER_BYTES",
    "PARTS",
    "PRESETS",
    "SEND_ORDERS",
    "Arrangement",
    "ArrivedBlock",
    "Manifest",
    "Packet",
    "PacketGroups",
    "PacketId",
    "PacketIntake",
    "PacketPlan",
    "Packetization",
    "ReadReport",
    "SceneStream",
    "StreamSizes",
    "TierShape",
    "arrange",
    "arrived_blocks",
    "file_head",
    "file_record",
    "is_stream",
    "make_packet",
    "make_stream",
    "make_stream_id",
    "manifest_from_bytes",
    "manifest_to_bytes",
    "measure_sizes",
    "packet_from_bytes",
    "packetization_named",
    "read_stream",
    "send_sequence",
    "shape_tiers",
    "splitmix64",
    "spread_packetization",
    "stream_from_bytes",
    "stream_to_bytes",
    "tier_order",
    "write_stream",
]
