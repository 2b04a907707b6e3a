"""Side information of the codec `causal` for neural anchors (docs/format.md)."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from splatwire.bitstream.limits import (
    CAUSAL,
    MAX_CAUSAL_CONTEXT,
    MAX_CAUSAL_FEATURES,
    MAX_CAUSAL_GROUPS,
    MAX_CAUSAL_OFFSETS,
    MAX_CAUSAL_STEP_OF_LOGS,
    MAX_CAUSAL_ZERO_POINT,
    MAX_CENTRE_DISTANCE,
    MAX_COORD,
    SCHEMAS,
)
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.codec.anchors.causal.positions import CoarsePositions, read_coarse_positions
from splatwire.codec.weight_bytes import framed, read_heads, read_networks, write_networks
from splatwire.codec.weights import QuantisedMlp
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import AnchorLayout
from splatwire.types.causal_coding import NUM_LOG_SCALINGS, CausalConfig

VERSION = 2
LOG_BITS = 24
"""Fractional bits of binary logarithms of scale and size, and of their steps."""


@dataclass(frozen=True, eq=False)
class SideInfo:
    """Side information of a stream of anchors with the causal model: data shared by all packets.

    Attributes:
        config: Layout of the anchors, and number of outputs of the network of positions.
        voxel_size: World units per voxel.
        positions: The high bits of all anchors' positions. The packets contain the low bits.
        middle: int64 (3), `CausalCoding.middle`, voxels.
        spread: int64 (3), `CausalCoding.spread`, voxels.
        linear_steps: Quantisation steps of each feature group, then of the offsets, float64 (groups + 1).
        steps_of_logs: Quantisation steps of the binary logarithms of offset scale and base size, int64 (2), `LOG_BITS`
            fractional bits.
        zero_points: int64 (4), zero points of an anchor's four binary logarithms (offset scale and three base sizes),
            `LOG_BITS` fractional bits.
        networks: Networks of `CausalConfig.shapes`, by name.
        heads: Rendering networks: opacity, covariance, colour.
        sections: Optional named sections, content by name.
    """

    config: CausalConfig
    voxel_size: float
    positions: CoarsePositions
    middle: np.ndarray
    spread: np.ndarray
    linear_steps: np.ndarray
    steps_of_logs: np.ndarray
    zero_points: np.ndarray
    networks: Mapping[str, QuantisedMlp]
    heads: tuple[QuantisedMlp, ...]
    sections: Mapping[str, bytes] = field(default_factory=dict)


def write_side_info(info: SideInfo) -> bytes:
    """Serialises the side information of a stream of anchors with the causal context model.

    Raises:
        InvalidValueError: If the model exceeds the format's limits, or a named section is invalid.
    """
    if wrong := _problem(info):
        raise InvalidValueError(f"side information: {wrong}")
    parts = {
        "header": _header(info),
        "positions": info.positions.section,
        "networks": write_networks(info.networks.values()),
        "render_networks": write_networks(info.heads),
    }
    return b"".join(framed(parts[name]) for name in SCHEMAS[CAUSAL].sections) + write_sections(info.sections)


def read_side_info(data: bytes, num_anchors: int) -> SideInfo:
    """Parses side information written by `write_side_info`.

    Args:
        data: The bytes.
        num_anchors: Anchors of the scene (from the manifest).

    Raises:
        UnsupportedVersionError: If a newer release wrote the side information.
        BitstreamError: If the bytes are damaged or not side information.
    """
    reader = ByteReader(data, "side information")
    header, section, networks, render = (reader.blob() for _ in SCHEMAS[CAUSAL].sections)
    sections = read_sections(reader.rest())
    info = _read_header(header, read_coarse_positions(section, num_anchors))
    config = info.config
    shapes = [(name, *shape) for name, shape in config.shapes().items()]
    parsed = read_networks(networks, shapes)
    return replace(
        info,
        networks={name: network for (name, *_), network in zip(shapes, parsed, strict=True)},
        heads=read_heads(render, config.layout),
        sections=sections,
    )


def _header(info: SideInfo) -> bytes:
    writer, layout = ByteWriter(), info.config.layout
    writer.u8(VERSION)
    for value in (layout.num_offsets, info.config.context_dim, len(layout.feature_groups), *layout.feature_groups):
        writer.unsigned(value)
    for step in (*info.linear_steps, info.voxel_size):
        writer.f64(float(step))
    for value in (*info.steps_of_logs, *info.spread):
        writer.unsigned(int(value))
    for value in (*info.zero_points, *info.middle):
        writer.signed(int(value))
    return writer.bytes()


def _read_header(data: bytes, positions: CoarsePositions) -> SideInfo:
    """Parses the header of the side information; the result has neither networks nor named sections.

    Args:
        data: Bytes of the header.
        positions: High bits of the anchors' positions, which are returned in the result.
    """
    reader = ByteReader(data, "side information header")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"side information has version {version}, this release reads version {VERSION}")
    num_offsets, context_dim, num_groups = (reader.unsigned() for _ in range(3))
    if not 0 < num_groups <= MAX_CAUSAL_GROUPS:
        raise BitstreamError(f"side information: {num_groups} feature groups")
    groups = tuple(reader.unsigned() for _ in range(num_groups))
    linear_steps = np.array([reader.f64() for _ in range(num_groups + 1)])
    voxel_size = reader.f64()
    unsigned = np.array([min(reader.unsigned(), MAX_COORD + 1) for _ in range(5)], dtype=np.int64)
    signed = np.array([_clipped(reader.signed()) for _ in range(NUM_LOG_SCALINGS + 3)], dtype=np.int64)
    reader.finish()
    try:
        config = CausalConfig(AnchorLayout(sum(groups), num_offsets, groups), context_dim)
    except ValueError as error:
        raise BitstreamError(f"side information: {error}") from None
    info = SideInfo(
        config, voxel_size, positions, signed[NUM_LOG_SCALINGS:], unsigned[2:], linear_steps, unsigned[:2],
        signed[:NUM_LOG_SCALINGS], {}, (),
    )  # fmt: skip
    if wrong := _problem(info):
        raise BitstreamError(f"side information: {wrong}")
    return info


def _clipped(value: int) -> int:
    return max(-MAX_COORD - 1, min(value, MAX_COORD + 1))


def _problem(info: SideInfo) -> str | None:
    """Returns a message about the first field beyond the format's limits; None if all fields are valid."""
    layout = info.config.layout
    if not (layout.num_offsets <= MAX_CAUSAL_OFFSETS and layout.feature_dim <= MAX_CAUSAL_FEATURES):
        return f"anchors of {layout.feature_dim} features and {layout.num_offsets} offsets"
    if not (0 < info.config.context_dim <= MAX_CAUSAL_CONTEXT and len(layout.feature_groups) <= MAX_CAUSAL_GROUPS):
        return f"{info.config.context_dim} numbers of context, {len(layout.feature_groups)} groups"
    if not all(1e-9 < step < 1e9 for step in info.linear_steps):
        return f"steps {info.linear_steps.tolist()}"
    if not 1e-9 < info.voxel_size < 1e9:
        return f"voxel size {info.voxel_size}"
    if not ((info.steps_of_logs > 0).all() and (info.steps_of_logs <= MAX_CAUSAL_STEP_OF_LOGS).all()):
        return f"steps of logarithms {info.steps_of_logs.tolist()}"
    if np.abs(info.zero_points).max() > MAX_CAUSAL_ZERO_POINT:
        return f"sizes around {info.zero_points.tolist()}"
    if not ((info.spread > 0).all() and (info.spread <= MAX_COORD).all() and np.abs(info.middle).max() <= MAX_COORD):
        return f"a scene {info.spread.tolist()} voxels around {info.middle.tolist()}"
    distances = np.abs(info.positions.known.corner - info.middle).tolist()
    if any(
        distance > MAX_CENTRE_DISTANCE * spread
        for distance, spread in zip(distances, info.spread.tolist(), strict=True)
    ):
        return f"anchors {distances} voxels from the middle of a scene of {info.spread.tolist()}"
    return None
