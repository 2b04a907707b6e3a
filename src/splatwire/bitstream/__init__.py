"""Stream format: division into packets, packet layout, manifest and streams on disk."""

import warnings
from typing import TYPE_CHECKING

from splatwire.bitstream.arrangement import PacketAssignment, PacketBatch, arrived_blocks, assign_packets
from splatwire.bitstream.container import file_head, file_record, stream_from_bytes, stream_to_bytes
from splatwire.bitstream.intake import PacketIntake, ReadReport
from splatwire.bitstream.limits import CAUSAL, GAUSSIANS, HACPP_ANCHORS
from splatwire.bitstream.manifest import Manifest, manifest_from_bytes, manifest_to_bytes
from splatwire.bitstream.packet import HEADER_BYTES, Packet, make_packet, packet_from_bytes
from splatwire.bitstream.packet_id import PARTS, PacketId
from splatwire.bitstream.packetization import PRESETS, Packetization, packetization_named, spread_packetization
from splatwire.bitstream.plan import PacketMembers, PacketPlan
from splatwire.bitstream.scene_stream import SceneStream, make_stream, make_stream_id
from splatwire.bitstream.send_order import SEND_ORDERS, send_sequence
from splatwire.bitstream.sizes import StreamSizes, measure_sizes
from splatwire.bitstream.splitmix64 import splitmix64
from splatwire.bitstream.stream import is_stream, read_stream, write_stream
from splatwire.bitstream.tiers import TierCounts, count_tiers, tier_order

__all__ = [
    "CAUSAL",
    "GAUSSIANS",
    "HACPP_ANCHORS",
    "HEADER_BYTES",
    "PARTS",
    "PRESETS",
    "SEND_ORDERS",
    "Manifest",
    "Packet",
    "PacketAssignment",
    "PacketBatch",
    "PacketId",
    "PacketIntake",
    "PacketMembers",
    "PacketPlan",
    "Packetization",
    "ReadReport",
    "SceneStream",
    "StreamSizes",
    "TierCounts",
    "arrived_blocks",
    "assign_packets",
    "count_tiers",
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
    "splitmix64",
    "spread_packetization",
    "stream_from_bytes",
    "stream_to_bytes",
    "tier_order",
    "write_stream",
]

_RENAMED = {"ANCHORS": "HACPP_ANCHORS"}
"""Current name of each deprecated name."""

if not TYPE_CHECKING:  # a type checker would accept any name of the package

    def __getattr__(name: str) -> object:
        """Returns the value of a deprecated name."""
        if name not in _RENAMED:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        text = f"{__name__}.{name} is deprecated, use {__name__}.{_RENAMED[name]}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return globals()[_RENAMED[name]]
