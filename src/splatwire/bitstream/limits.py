"""Names and limits of the stream format. The web decoder uses the same ones."""

from dataclasses import dataclass

from splatwire.plugins import Registry

# `web/scripts/make_tables.py` writes the same values to `web/src/packets/limits.ts`.
MANIFEST_FORMAT = "splatwire/stream"
"""Value of the field `schema` of every manifest, which identifies the file as the manifest of a stream."""
FORMAT_VERSION = 5
"""Newest version of the stream format that this release reads."""

MAX_BLOCK_SIZE = (1 << 16) - 1
MAX_HASHED_BLOCK = 1 << 14
"""Largest block with hashed grouping, elements. `PacketId.index_in_block` is then the index of an element, for which
the header has 14 bits.
"""
MAX_BLOCKS = 1 << 24
MAX_LANES = 1 << 8
MAX_STREAM_LANES = (1 << 31) - 1
"""Maximum number of lanes of all blocks. A lane is one packet, or one for each part with separated packaging."""
MIN_PACKET_BYTES = 128
MAX_HASHED_PACKET_BYTES = 65_507
"""Largest packet with hashed grouping (`Packetization.packet_bytes`), bytes: the largest payload of a UDP datagram."""
MAX_PACKET_BYTES = 1 << 26
"""Largest packet, bytes: more than 1000 bytes for each element of the largest block."""
MAX_TIERS = 8
MAX_SPANS = 1 << 12
"""Maximum number of tiers (ranges of consecutive blocks) of a sequence. Each group of frames has two tiers
(`StreamSchema.timed`).
"""
MAX_FEATURE_GROUPS = 64
CODING_ORDERS = ("morton", "raster")
GROUPINGS = ("stratified", "contiguous", "hashed")
PACKAGINGS = ("atomic", "separated")

MAX_MANIFEST_BYTES = 1 << 16
MAX_SIDE_INFO_BYTES = (1 << 32) - 1
MAX_WRITER_LENGTH = 80
MAX_FEATURE_DIM = 4096
MAX_OFFSETS = 1024

MAX_SECTIONS = 16
MAX_SECTION_BYTES = 1 << 26
MAX_SECTION_NAME = 32

MAX_ELEMENTS = 1 << 28
FREE_ELEMENTS = 1 << 16
"""Number of elements that a manifest may announce with any size of side information.

Larger numbers are limited to `StreamSchema.elements_per_byte` elements per byte of side information.
"""

FREE_BYTES = 150 << 20
"""Memory that decoding any stream may take, bytes."""
BYTES_PER_BYTE = 160
"""Additional memory that decoding may take per received byte, bytes."""

MAX_POSITION_BITS = 63
"""Maximum size of the Morton code of an anchor's voxel, counted from the corner, bits."""
MAX_COORD = 1 << 40
"""Largest coordinate of the corner and of the scene's centre, and largest spread of a scene, voxels."""
MAX_CENTRE_DISTANCE = 1 << 25
"""Maximum distance between corner and scene centre, in spreads of the scene; keeps positions relative to the spread
exact in doubles.
"""
MAX_LEAF = 64
"""Maximum number of anchors in a leaf of the position tree: anchors whose Morton codes have the same prefix in the side
information."""
MAX_CAUSAL_GROUPS = 32
MAX_CAUSAL_FEATURES = 256
MAX_CAUSAL_OFFSETS = 64
MAX_CAUSAL_CONTEXT = 256
MAX_CAUSAL_STEP_OF_LOGS, MAX_CAUSAL_ZERO_POINT = 4 << 24, 32 << 24
"""Maxima in a stream of schema `causal`: quantisation step of the base-2 logarithms of the offsets' scale and of the
size, and their zero point; 24 fractional bits.
"""
MAX_DEGREE = 3
MAX_FRAMES = 1 << 20
MAX_GROUP_FRAMES = 64
MAX_FRAME_RATE = 1000
"""Limits of a sequence: frames in total, frames per group, frames per second."""
MAX_SIZE_LOG = 32
MAX_COPIES = (1 << 16) - 1


@dataclass(frozen=True)
class StreamSchema:
    """Properties of a schema that manifests and packet plans depend on.

    Attributes:
        name: Name in the manifest.
        format_version: Version of the stream format that introduced the schema.
        elements: Plural name of the elements (`anchors`, `Gaussians`, `tracks`), for messages.
        sections: Fixed sections of the side information, in order.
        elements_per_byte: Maximum number of elements per byte of side information. A manifest with more is rejected as
            forged.
        layout: True if the manifest contains the sizes of an anchor's attributes.
        separable: True if packets may contain single attributes (separated packaging).
        large_blocks: True if the default packetization is the preset `spread` (blocks as large as possible), False if
            it is `paper` (small blocks).
        explicit: True if the elements are Gaussians, which are the same in all views; False for anchors, from which
            Gaussians are generated for each view.
        page: True if the web decoder supports the schema.
        timed: True for sequences: elements belong to groups of frames. The keyframes and the motion of each group have
            separate packets.
        tiled: True if a block is a tile that viewers request individually.
        max_tiers: Maximum number of importance tiers.
        codec_path: Import path `module:name` of the complete schema, a `Schema` with encoder and decoder. Empty if this
            object itself is a `Schema`, a subclass of `StreamSchema`.
        scene_path: Import path `module:name` of the scene class. Empty if this object itself is a `Schema`.
    """

    name: str
    format_version: int
    elements: str
    sections: tuple[str, ...]
    elements_per_byte: int
    layout: bool = False
    separable: bool = False
    large_blocks: bool = True
    explicit: bool = False
    page: bool = True
    timed: bool = False
    tiled: bool = False
    max_tiers: int = MAX_TIERS
    codec_path: str = ""
    scene_path: str = ""


HACPP_ANCHORS, CAUSAL, GAUSSIANS, TRACKS = "hacpp", "causal", "gaussians", "tracks"
LEVELS, UPDATE = "levels", "update"
"""Names of schemas: anchors of HAC++ (format 1); anchors of the causal model and explicit Gaussians (format 2);
moving Gaussians (format 3); Gaussians with levels of detail (format 4); changes of a stream of Gaussians (format 5).
"""
FORMAT_1_SECTIONS = (
    "header", "positions", "grid", "prior_network", "channel_networks", "render_networks", "mask_models"
)  # fmt: skip
SCHEMAS: Registry[StreamSchema] = Registry("schema", "splatwire.schemas")
"""Registry of all schemas; packages add their own with `splatwire.codec.register_schema`."""
for _schema in (
    StreamSchema(
        HACPP_ANCHORS, 1, "anchors", FORMAT_1_SECTIONS, 1024, layout=True, separable=True, page=False,
        codec_path="splatwire.codec.anchors.hacpp.schema:SCHEMA",
        scene_path="splatwire.types.anchor_scene:AnchorScene",
    ),
    StreamSchema(
        CAUSAL, 2, "anchors", ("header", "positions", "networks", "render_networks"), 1024,
        codec_path="splatwire.codec.anchors.causal.schema:SCHEMA",
        scene_path="splatwire.types.anchor_scene:AnchorScene",
    ),
    StreamSchema(
        GAUSSIANS, 2, "Gaussians", ("header", "blocks", "contexts"), MAX_BLOCK_SIZE // 7, large_blocks=False,
        explicit=True, codec_path="splatwire.codec.gaussians.schema:SCHEMA",
        scene_path="splatwire.types.splat_scene:SplatScene",
    ),
    StreamSchema(
        LEVELS, 4, "Gaussians", ("header", "blocks", "contexts"), MAX_BLOCK_SIZE // 7, large_blocks=False,
        explicit=True, tiled=True, codec_path="splatwire.codec.lod.schema:SCHEMA",
        scene_path="splatwire.types.lod_scene:LevelScene",
    ),
    StreamSchema(
        UPDATE, 5, "Gaussians", ("header", "blocks", "contexts"), MAX_BLOCK_SIZE // 7, large_blocks=False,
        explicit=True, page=False, codec_path="splatwire.codec.update.schema:SCHEMA",
        scene_path="splatwire.types.update_scene:UpdateScene",
    ),
    StreamSchema(
        TRACKS, 3, "tracks", ("clip", "keyframes", "motion"), MAX_BLOCK_SIZE // 7, large_blocks=False, explicit=True,
        timed=True, max_tiers=MAX_SPANS, codec_path="splatwire.codec.sequence.schema:SCHEMA",
        scene_path="splatwire.types.sequence_scene:SequenceScene",
    ),
):  # fmt: skip
    SCHEMAS.register(_schema.name, _schema, f"{__name__}.{_schema.name}")
UNNAMED_SCHEMA = HACPP_ANCHORS
"""Schema of manifests without a field `codec`, which are of format 1."""

RESERVED_SECTIONS = FORMAT_1_SECTIONS
"""Names that no named section may have, for any schema."""
