"""What a stream may be: every name and limit on which this reader and the page's must agree.

`web/scripts/make_tables.py` writes the same for the page, `web/src/packets/limits.ts`.
"""

from dataclasses import dataclass

SCHEMA = "splatwire/stream"
FORMAT_VERSION = 4
"""Newest version of the stream format that this release reads."""

MAX_BLOCK_SIZE = (1 << 16) - 1
MAX_HASHED_BLOCK = 1 << 14
"""With hashed grouping `PacketId.lane` is a position within the block, and the header has 14 bits for it."""
MAX_BLOCKS = 1 << 24
MAX_LANES = 1 << 8
MAX_GROUPS = (1 << 31) - 1
MIN_PACKET_BYTES = 128
MAX_DATAGRAM_BYTES = 65_507
MAX_PACKET_BYTES = 1 << 26
"""No packet is larger: more than 1000 bytes for each of the most anchors a block may hold."""
MAX_TIERS = 8
MAX_SPANS = 1 << 12
"""Runs of blocks of a stream whose elements come in time: `StreamSchema.max_tiers` of those."""
MAX_FEATURE_GROUPS = 64
ORDERS = ("morton", "raster")
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
"""More elements than these need a byte of side information for every so many of them: see `StreamSchema`."""

FREE_BYTES = 150 << 20
"""Of memory, what decoding a stream may take whatever its size."""
BYTES_PER_BYTE = 160
"""Of memory, what it may take beyond that for each byte that arrived."""

MAX_POSITION_BITS = 63
"""Of the Morton code of an anchor's voxel, counted from the origin."""
MAX_PLACE = 1 << 40
"""Of a coordinate of the origin and of the scene's middle, and of its extent, voxels."""
MAX_FAR = 1 << 25
"""Extents of the scene between origin and middle: what is relative to the extent is exact in doubles, too."""
MAX_LEAF = 64
"""Anchors whose codes the side information does not tell apart."""
MAX_CAUSAL_GROUPS = 32
MAX_CAUSAL_FEATURES = 256
MAX_CAUSAL_OFFSETS = 64
MAX_CAUSAL_CONTEXT = 256
MAX_CAUSAL_LOG_STEP, MAX_CAUSAL_CENTRE = 4 << 24, 32 << 24
"""Logarithms with 24 fractional bits."""
MAX_DEGREE = 3
MAX_FRAMES = 1 << 20
MAX_GROUP_FRAMES = 64
MAX_FRAME_RATE = 1000
"""Of a clip: its frames, those of a group, and frames a second."""
MAX_SIZE_LOG = 32
MAX_COPIES = (1 << 16) - 1


@dataclass(frozen=True)
class StreamSchema:
    """What a manifest and its sections say of elements of one kind.

    Attributes:
        name: Name in the manifest.
        format_version: Version of the stream format that has it.
        elements: What the elements are called.
        sections: Sections of side information that every such stream has, in this order; they have no name in the
            bytes.
        elements_per_byte: Most elements to a byte of side information: far more than places of anchors, or the box of
            a block of Gaussians, allow, yet few enough that no small manifest announces billions.
        layout: Whether the manifest says how large an anchor is.
        separable: Whether packets may hold single attributes.
        spread: Whether packets are spread over the whole scene unless somebody says otherwise; no where elements say
            in their packets where they are: lanes over the whole scene would take 1 to 9 % more bytes of Gaussians.
        explicit: Whether every view sees the same Gaussians, so that files of them hold what was decoded.
        page: Whether the page decodes it by itself.
        timed: Whether elements belong to groups of frames, two tiers each: what lasts, then what passes with the group.
            They are sent in that order; what lasts is sent again until it is there.
        tiled: Whether a block is a tile that a view asks for by itself: what is sent comes tile by tile.
        max_tiers: Runs of blocks that a plan may have.
    """

    name: str
    format_version: int
    elements: str
    sections: tuple[str, ...]
    elements_per_byte: int
    layout: bool = False
    separable: bool = False
    spread: bool = True
    explicit: bool = False
    page: bool = True
    timed: bool = False
    tiled: bool = False
    max_tiers: int = MAX_TIERS


ANCHORS, CAUSAL, GAUSSIANS, COLUMNS, TRACKS = "hacpp", "causal", "gaussians", "columns", "tracks"
LEVELS = "levels"
"""Codec schemas: anchors of HAC++ (format 1), anchors of the causal model, explicit Gaussians (format 2); decoded
anchors on their way to the page of `splatwire view`; Gaussians that move (format 3); levels of Gaussians (format 4)."""
FORMAT_1_SECTIONS = (
    "header", "positions", "grid", "prior_network", "channel_networks", "render_networks", "mask_models"
)  # fmt: skip
SCHEMAS = {
    schema.name: schema
    for schema in (
        StreamSchema(ANCHORS, 1, "anchors", FORMAT_1_SECTIONS, 1024, layout=True, separable=True, page=False),
        StreamSchema(CAUSAL, 2, "anchors", ("header", "positions", "networks", "render_networks"), 1024),
        StreamSchema(
            GAUSSIANS,
            2,
            "Gaussians",
            ("header", "blocks", "contexts"),
            MAX_BLOCK_SIZE // 7,
            spread=False,
            explicit=True,
        ),
        StreamSchema(
            LEVELS,
            4,
            "Gaussians",
            ("header", "blocks", "contexts"),
            MAX_BLOCK_SIZE // 7,
            spread=False,
            explicit=True,
            tiled=True,
        ),
        StreamSchema(COLUMNS, 2, "anchors", ("header", "render_networks", "expected"), 1),
        StreamSchema(
            TRACKS,
            3,
            "tracks",
            ("clip", "bases", "motion"),
            MAX_BLOCK_SIZE // 7,
            spread=False,
            explicit=True,
            timed=True,
            max_tiers=MAX_SPANS,
        ),
    )
}
UNNAMED_SCHEMA = ANCHORS
"""Schema of manifests that name none, which are of format 1."""


def register_stream_schema(schema: StreamSchema) -> None:
    """Makes another kind of element known to readers of streams."""
    assert SCHEMAS.setdefault(schema.name, schema) == schema, f"a schema '{schema.name}' is registered already"


RESERVED_SECTIONS = FORMAT_1_SECTIONS
"""Names that no named section may have, whatever the schema."""
