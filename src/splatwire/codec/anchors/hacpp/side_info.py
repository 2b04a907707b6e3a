"""Side information of HAC++ anchors (codec `hacpp`), serialised with a version number (docs/format.md)."""
# A decoder needs only these bytes and the packets. An encoder reads the bytes back after writing them, so that it
# predicts from the same numbers as a decoder.

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from splatwire.bitstream.limits import HACPP_ANCHORS, SCHEMAS
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.codec.anchors.hacpp.coding_params import CodingContext
from splatwire.codec.anchors.hacpp.grid_lookup import grid_levels, touched_rows, unit_coordinates
from splatwire.codec.anchors.hacpp.grid_signs import decode_signs, encode_signs
from splatwire.codec.geometry import decode_positions, encode_positions
from splatwire.codec.weight_bytes import framed, read_heads, read_networks, write_networks
from splatwire.codec.weights import QuantisedMlp
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import AnchorLayout, HacppConfig, HashGridConfig

VERSION = 1
MASK_CONTEXTS = 4
"""Number of mask models per offset, see `_packet_kernels.mask_context`."""
MAX_GRID_VALUES = 1 << 24
MAX_LEVELS = 64
MAX_OFFSETS = 64
MAX_FEATURES = 1024


@dataclass(frozen=True, eq=False)
class SideInfo:
    """Side information of a stream of HAC++ anchors: data shared by all packets.

    Attributes:
        config: Sizes of the model's networks and tables.
        voxel_size: World units per voxel.
        bounds_min: Lower corner of the hash grid's bounding box, float32 (3).
        bounds_max: Upper corner of the hash grid's bounding box, float32 (3).
        voxels: Positions of all anchors in voxels, int64 (N, 3); in coding order after reading.
        signs: Entries of the binary hash grid, -1 or +1, int8 (rows, D).
        prior: Prior network.
        channel: Networks of the channel context, one per feature group.
        heads: Rendering networks: opacity, covariance, colour.
        mask_zero_probabilities: Initial probability that a bit is 0, for each adaptive model of offset masks, out of
            2**8, int64 (contexts).
        sections: Optional named sections, content by name.
    """

    config: HacppConfig
    voxel_size: float
    bounds_min: np.ndarray
    bounds_max: np.ndarray
    voxels: np.ndarray
    signs: np.ndarray
    prior: QuantisedMlp
    channel: tuple[QuantisedMlp, ...]
    heads: tuple[QuantisedMlp, QuantisedMlp, QuantisedMlp]
    mask_zero_probabilities: np.ndarray
    sections: Mapping[str, bytes] = field(default_factory=dict)

    def coding_context(self) -> CodingContext:
        """Returns the coding context, with networks converted to integers."""
        return CodingContext(
            self.config, self.voxel_size, self.bounds_min, self.bounds_max, self.signs,
            self.prior.integer(), tuple(mlp.integer() for mlp in self.channel),
        )  # fmt: skip

    def mask_models(self) -> np.ndarray:
        """Initial state of the adaptive bit models of offset masks, equal for all packets, int64 (contexts, 2)."""
        return np.repeat(self.mask_zero_probabilities[:, None] << 8, 2, axis=1)


def write_side_info(info: SideInfo) -> bytes:
    """Serialises the side information of a stream of HAC++ anchors.

    Args:
        info: The side information; `voxels` in any order.

    Returns:
        The bytes.

    Raises:
        InvalidValueError: If the model exceeds the format's limits, or a named section is invalid.
    """
    _check_config(info.config, InvalidValueError)
    units = unit_coordinates(info.voxels, info.voxel_size, info.bounds_min, info.bounds_max)
    parts = {
        "header": _header(info),
        "positions": encode_positions(info.voxels),
        "grid": encode_signs(info.signs, touched_rows(units, info.config.grid), info.config.grid),
        "prior_network": write_networks([info.prior]),
        "channel_networks": write_networks(info.channel),
        "render_networks": write_networks(info.heads),
        "mask_models": bytes(info.mask_zero_probabilities.astype(np.uint8)),
    }
    return b"".join(framed(parts[name]) for name in SCHEMAS[HACPP_ANCHORS].sections) + write_sections(info.sections)


def read_side_info(data: bytes, num_anchors: int, order: str) -> SideInfo:
    """Parses side information written by `write_side_info`.

    Args:
        data: The bytes.
        num_anchors: Anchors of the scene (from the manifest).
        order: Order of the anchors in packets (from the manifest).

    Returns:
        The side information, with `voxels` in coding order.

    Raises:
        UnsupportedVersionError: If a newer release wrote the side information.
        BitstreamError: If the bytes are damaged or not side information.
    """
    reader = ByteReader(data, "side information")
    blobs = [reader.blob() for _ in SCHEMAS[HACPP_ANCHORS].sections]
    sections = read_sections(reader.rest())
    config, voxel_size, bounds = _read_header(blobs[0])
    voxels = decode_positions(blobs[1], num_anchors, order)
    try:
        touched = touched_rows(unit_coordinates(voxels, voxel_size, *bounds), config.grid)
    except InvalidValueError as error:
        raise BitstreamError(f"side information: {error}") from None
    groups, features, offsets = config.layout.feature_groups, config.layout.feature_dim, config.layout.num_offsets
    group_starts = np.cumsum([0, *groups])
    if len(blobs[6]) != MASK_CONTEXTS * offsets:
        raise BitstreamError(f"side information: {len(blobs[6])} mask models, not {MASK_CONTEXTS * offsets}")
    prior = read_networks(blobs[3], [("prior", config.grid.context_dim, config.prior_dim)])
    shapes = [
        ("channel", int(start) + 3 * features, 3 * size) for start, size in zip(group_starts, groups, strict=False)
    ]
    return SideInfo(
        config, voxel_size, *bounds, voxels, decode_signs(blobs[2], touched, config.grid),
        prior[0], tuple(read_networks(blobs[4], shapes)), read_heads(blobs[5], config.layout),
        np.clip(np.frombuffer(blobs[6], dtype=np.uint8).astype(np.int64), 1, 255), sections,
    )  # fmt: skip


def _header(info: SideInfo) -> bytes:
    writer, grid, layout = ByteWriter(), info.config.grid, info.config.layout
    writer.u8(VERSION)
    for value in (
        layout.feature_dim,
        layout.num_offsets,
        grid.features_per_level,
        grid.log2_rows_3d,
        grid.log2_rows_2d,
    ):
        writer.unsigned(value)
    for values in (layout.feature_groups, grid.resolutions_3d, grid.resolutions_2d):
        writer.unsigned(len(values))
        for value in values:
            writer.unsigned(value)
    for base in info.config.base_steps:
        writer.f64(base)
    writer.f64(info.voxel_size)
    for corner in (*info.bounds_min, *info.bounds_max):
        writer.f32(float(corner))
    return writer.bytes()


def _read_header(data: bytes) -> tuple[HacppConfig, float, tuple[np.ndarray, np.ndarray]]:
    reader = ByteReader(data, "side information header")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"side information has version {version}, this release reads version {VERSION}")
    features, offsets, depth, log2_3d, log2_2d = (reader.unsigned() for _ in range(5))
    lists = []
    for name in ("feature groups", "3D levels", "2D levels"):
        count = reader.unsigned()
        if not 0 < count <= MAX_LEVELS:
            raise BitstreamError(f"side information: {count} {name}")
        lists.append(tuple(reader.unsigned() for _ in range(count)))
    steps = (reader.f64(), reader.f64(), reader.f64())
    voxel_size = reader.f64()
    corners = np.array([reader.f32() for _ in range(6)], dtype=np.float32)
    reader.finish()
    try:
        layout = AnchorLayout(features, offsets, lists[0])
    except ValueError as error:
        raise BitstreamError(f"side information: {error}") from None
    config = HacppConfig(layout, HashGridConfig(depth, lists[1], lists[2], log2_3d, log2_2d), steps)
    _check_config(config, BitstreamError)
    bounds = corners[:3], corners[3:]
    if not (1e-9 < voxel_size < 1e9 and np.isfinite(corners).all() and (bounds[1] > bounds[0]).all()):
        raise BitstreamError(f"side information: voxel size {voxel_size} or bounds {corners.tolist()} are impossible")
    return config, voxel_size, bounds


def _check_config(config: HacppConfig, error: type[BitstreamError] | type[InvalidValueError]) -> None:
    """Checks that the sizes of a model are within the format's limits.

    Args:
        config: Sizes of the model's networks and tables.
        error: Type of the exception to raise: `BitstreamError` when reading, `InvalidValueError` when writing.
    """
    grid, layout = config.grid, config.layout
    small = (
        layout.num_offsets <= MAX_OFFSETS and layout.feature_dim <= MAX_FEATURES and max(layout.feature_groups) <= 64
    )
    levels = all(3 <= r <= 1 << 14 for r in (*grid.resolutions_3d, *grid.resolutions_2d))
    tables = 0 < grid.features_per_level <= 8 and min(grid.log2_rows_3d, grid.log2_rows_2d) > 0
    tables = tables and max(grid.log2_rows_3d, grid.log2_rows_2d) <= 24
    if not (small and levels and tables and all(1e-6 <= base <= 1e3 for base in config.base_steps)):
        raise error(f"side information: a model of this shape is beyond the format: {config}")
    if grid_levels(grid).num_rows * grid.features_per_level > MAX_GRID_VALUES:
        raise error(f"side information: a hash grid of {grid_levels(grid).num_rows} rows is too large")
