"""An encoded scene: side information and packets, complete or after losses."""

import hashlib
import struct
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from splatwire.arguments import check_fields, checked
from splatwire.bitstream.limits import UNNAMED_SCHEMA, UPDATE
from splatwire.bitstream.manifest import Manifest, manifest_to_bytes, packetization_to_json
from splatwire.bitstream.packet import HEADER_BYTES, Packet, make_packet
from splatwire.bitstream.packet_id import PacketId
from splatwire.bitstream.packetization import Packetization
from splatwire.bitstream.plan import PacketPlan
from splatwire.bitstream.tiers import TierCounts
from splatwire.errors import InvalidValueError
from splatwire.reprs import summary_repr

FILE_MAGIC = b"\x93SWZ"
FILE_VERSION = 1
FILE_PREFIX = struct.Struct("<4sBI")
"""Start of a file: magic, version of the one-file layout, size of the manifest."""
RECORD_PREFIX = struct.Struct("<I")
"""Start of a packet record: size of the packet that follows."""


@dataclass(frozen=True)
class SceneStream:
    """Encoded scene: manifest, side information, and all or a part of the packets.

    Attributes:
        manifest: Description of the complete stream.
        side_info: Data shared by all packets; never lost.
        packets: Available packets, ascending by id.

    Raises:
        InvalidValueError: If packets are out of order or duplicated.
    """

    manifest: Manifest
    side_info: bytes
    packets: tuple[Packet, ...]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if any(a.id >= b.id for a, b in zip(self.packets, self.packets[1:], strict=False)):
            raise InvalidValueError("packets of a stream must be ascending by id, each there once")

    @property
    def num_bytes(self) -> int:
        """Size of the stream as one file, bytes."""
        return sum(self.part_sizes().values())

    def part_sizes(self) -> dict[str, int]:
        """Returns the size of each part of the stream's file, bytes; `container` is the overhead of the file format."""
        return {
            "manifest": len(manifest_to_bytes(self.manifest)),
            "side_info": len(self.side_info),
            "packet_headers": HEADER_BYTES * len(self.packets),
            "packet_payloads": sum(packet.num_bytes - HEADER_BYTES for packet in self.packets),
            "container": FILE_PREFIX.size + RECORD_PREFIX.size * len(self.packets),
        }

    def require_static(self, source: object = "the stream") -> "SceneStream":
        """Checks that the stream contains a static scene (no sequence or update), and returns the stream itself.

        Args:
            source: Source of the stream, for the message.

        Raises:
            InvalidValueError: If the stream is a sequence or an update.
        """
        if self.manifest.schema.timed:
            raise InvalidValueError(f"{source} is a clip, and this takes scenes; `decode` writes its frames as scenes")
        return self.require_scene(source)

    def require_scene(self, source: object = "the stream") -> "SceneStream":
        """Checks that the stream is not an update, which can be neither decoded nor shown without its scene.

        Args:
            source: Source of the stream, for the message.

        Returns:
            The stream itself.

        Raises:
            InvalidValueError: If the stream is an update.
        """
        if self.manifest.schema_name == UPDATE:
            raise InvalidValueError(
                f"{source} is an update, which has only the changes of a scene: `apply` makes a stream of both"
            )
        return self

    def still(self, source: object = "the stream") -> "SceneStream":
        """Deprecated name of `require_static`."""
        warnings.warn("SceneStream.still is deprecated, use require_static", DeprecationWarning, stacklevel=2)
        return self.require_static(source)

    def parts(self) -> dict[str, int]:
        """Deprecated name of `part_sizes`."""
        warnings.warn("SceneStream.parts is deprecated, use part_sizes", DeprecationWarning, stacklevel=2)
        return self.part_sizes()

    @checked
    def with_packets(self, packets: Iterable[Packet]) -> "SceneStream":
        """Returns a copy of the stream with the given packets, in any order."""
        return replace(self, packets=tuple(sorted(packets, key=lambda packet: packet.id)))


@checked
def make_stream_id(packetization: Packetization, side_info: bytes, packets: Sequence[Packet]) -> int:
    """Returns the id of a new stream: 32 bits of a SHA-256 of the content.

    Sections that are added or removed later (`with_section`, `without_section`) do not change the id of the stream.

    Args:
        packetization: Parameters of the division into packets.
        side_info: The side information.
        packets: All packets of the complete stream, in order.
    """
    digest = hashlib.sha256(b"splatwire/stream-id/1\0" + packetization_to_json(packetization))
    digest.update(struct.pack("<Q", len(side_info)))
    digest.update(side_info)
    for packet in packets:
        payload = packet.payload
        head = (packet.id.block, packet.id.index_in_block, packet.id.part, packet.num_elements, len(payload))
        digest.update(struct.pack("<5I", *head))
        digest.update(payload)
    return int.from_bytes(digest.digest()[:4], "little")


@checked
def make_stream(
    *,
    packetization: Packetization,
    num_elements: int,
    side_info: bytes,
    packets: Iterable[Packet],
    symbols_digest: str,
    writer: str,
    tiers: tuple[TierCounts, ...] = (),
    schema_name: str = UNNAMED_SCHEMA,
    feature_dim: int = 0,
    num_offsets: int = 0,
    feature_groups: tuple[int, ...] = (),
) -> SceneStream:
    """Builds a complete stream: sorts the packets, computes the id and creates the manifest.

    Args:
        packetization: Parameters of the division into packets.
        num_elements: Number of elements of the scene, N.
        side_info: The side information.
        packets: All packets. Their stream ids are replaced by the id of the new stream.
        symbols_digest: SHA-256 of all decoded integers (see `Manifest.symbols_digest`), hexadecimal.
        writer: Name and version of the program.
        tiers: Element counts of the importance tiers; empty for a single tier.
        schema_name: Name of the schema of the elements, a key of `splatwire.bitstream.limits.SCHEMAS`.
        feature_dim: Channels of the anchor feature, F; 0 for Gaussians, or if the side information has this number.
        num_offsets: Offsets per anchor, K; 0 for Gaussians, or if the side information has this number.
        feature_groups: Sizes of the feature's channel groups.

    Raises:
        InvalidValueError: If the packets are not exactly the packets of the plan.
    """
    ordered = sorted(packets, key=lambda packet: packet.id)
    manifest = Manifest(
        packetization=packetization,
        num_elements=num_elements,
        schema_name=schema_name,
        feature_dim=feature_dim,
        num_offsets=num_offsets,
        feature_groups=feature_groups,
        num_packets=len(ordered),
        stream_id=make_stream_id(packetization, side_info, ordered),
        side_info_bytes=len(side_info),
        side_info_digest=hashlib.sha256(side_info).hexdigest(),
        symbols_digest=symbols_digest,
        writer=writer,
        tiers=tiers,
    )
    if not _is_complete(manifest.plan, ordered):
        raise InvalidValueError("the packets of a new stream must be exactly those of its plan")
    # In place: if the caller has released its packets, a large stream is not in memory twice.
    for i, packet in enumerate(ordered):
        ordered[i] = make_packet(packet.id, packet.num_elements, packet.payload, manifest.stream_id)
    return SceneStream(manifest, side_info, tuple(ordered))


def _is_complete(plan: PacketPlan, packets: Sequence[Packet]) -> bool:
    """True if packets contain every element exactly once."""
    if not plan.packetization.hashed:
        expected = [(packet_id, plan.count(packet_id)) for packet_id in plan.ids]
        return [(packet.id, packet.num_elements) for packet in packets] == expected
    # No call of the plan per packet, because a scene has thousands of datagrams.
    max_bytes = plan.packetization.packet_bytes
    sizes = [plan.block_elements(block) for block in range(plan.num_blocks)]
    block, position = 0, 0
    for packet in packets:
        if block < len(sizes) and position == sizes[block]:
            block, position = block + 1, 0
        end = position + packet.num_elements
        if block == len(sizes) or not position < end <= sizes[block]:
            return False
        if packet.id != PacketId(block, position) or packet.num_bytes > max_bytes:
            return False
        position = end
    return block == len(sizes) - 1 and position == sizes[block] if packets else not plan.num_elements
