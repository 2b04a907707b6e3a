"""Anchors as decoded columns: how a stream that browsers do not decode (format 1) reaches the page that draws it.

A stream of columns never leaves the machine that made it: it goes from the page server to its own page. Packets, plan,
tiers and lanes are those of the stream; a packet's payload is float32 rows and masks (`rows_of`) in place of coded
integers, the head has the networks and what the prior expects of every anchor. Its twin is `web/src/codec/columns`.
"""

import hashlib
import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int64

from splatwire.byte_io import ByteWriter
from splatwire.codec import decode_stream, schema_named
from splatwire.codec.tiers import arrange_stream
from splatwire.codec.weight_bytes import framed
from splatwire.conceal.sketch.concealer import buckets_of, sizes_of, with_sketch
from splatwire.conceal.sketch.section import SECTION as SKETCH
from splatwire.conceal.sketch.section import read_sketch
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.model import AnchorScene, Mlp, Partial, Prior
from splatwire.ops.arrays import lower_median, to_arrays, to_numpy
from splatwire.packets import COLUMNS, Manifest, Packet, SceneStream, make_packet
from splatwire.packets.limits import MAX_DATAGRAM_BYTES
from splatwire.packets.sections import split_sections, write_sections
from splatwire.scene import Anchors

VERSION = 1
SMALLEST = 1e-9
_PASSED_ON = ("background", "viewpoint", "up", "preview", "tiers", "tier_sizes")
"""Sections that say of columns what they say of the stream."""
_DOUBTS = (1e-3, 1e3), (1e-4, 1e3)
"""Limits of what is told of how far features and lengths are expected to be off."""


def columns_of(stream: SceneStream, progress: Callable[[float], None] | None = None) -> SceneStream:
    """Decodes a stream of anchors and gives what arrived as columns.

    Args:
        stream: A stream whose packets hold whole anchors.
        progress: Called with the share of the decoding that is done, 0 to 1.

    Raises:
        InvalidValueError: If it has no anchors.
        BitstreamError: If the stream contradicts itself, or its packets hold parts of anchors.
        DesyncError: If the decoded integers are not those that were encoded.
    """
    if Prior not in schema_named(stream.manifest.codec).offers:
        raise InvalidValueError(f"a stream of {stream.manifest.elements} is not for browsers: no page decodes it")
    if stream.manifest.packetization.separated:
        raise BitstreamError("packets of separated attributes cannot be shown one by one; encode with another --preset")
    partial = decode_stream(stream, progress=progress)
    manifest, side_info = columns_head(stream.manifest, stream.side_info, partial)
    groups, packets = arrange_stream(stream)
    pieces = zip(packets, itertools.pairwise(groups.starts), strict=True)
    columns = (
        columns_packet(packet, rows_of(partial.scene.anchors, groups.ranks[a:b].copy()), manifest)
        for packet, (a, b) in pieces
        if packet is not None
    )
    return SceneStream(manifest, side_info, tuple(columns))


def columns_head(manifest: Manifest, side_info: bytes, partial: Partial[AnchorScene]) -> tuple[Manifest, bytes]:
    """Manifest and side information of the columns of a stream.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        partial: What is decoded of it by now.
    """
    content = _side_info(partial, split_sections(side_info, manifest.codec)[1])
    packetization = manifest.packetization
    if packetization.hashed:
        packetization = replace(packetization, packet_bytes=MAX_DATAGRAM_BYTES)
    described = replace(
        manifest, codec=COLUMNS, packetization=packetization, side_info_bytes=len(content),
        side_info_digest=hashlib.sha256(content).hexdigest(), feature_dim=0, num_offsets=0, feature_groups=(),
    )  # fmt: skip
    return described, content


def columns_packet(packet: Packet, payload: bytes, manifest: Manifest) -> Packet:
    """The packet that has the rows of its anchors in place of their coded integers."""
    return make_packet(packet.id, packet.num_elements, payload, manifest.stream_id)


def _side_info(partial: Partial[AnchorScene], sections: Mapping[str, bytes]) -> bytes:
    anchors, layout = to_arrays(partial.scene.anchors), partial.scene.coding.config.layout
    middle = lower_median(anchors.positions).astype(np.float64)
    size = float(lower_median(np.linalg.norm(anchors.positions - middle, axis=1)))
    writer = ByteWriter()
    writer.u8(VERSION)
    writer.unsigned(layout.feature_dim)
    writer.unsigned(layout.num_offsets)
    for value in (max(size, SMALLEST), *middle.tolist()):
        writer.f64(value)
    passed = {name: content for name, content in sections.items() if name in _PASSED_ON}
    if SKETCH in sections:
        passed["copies"] = _copies(partial, sections[SKETCH])
    heads = to_arrays(partial.scene.heads)
    networks = b"".join(map(_mlp_bytes, (heads.opacity, heads.covariance, heads.color)))
    parts = (writer.bytes(), networks, _float_bytes(expected_columns(partial)))
    return b"".join(map(framed, parts)) + write_sections(passed)


def expected_columns(partial: Partial[AnchorScene]) -> Float[np.ndarray, "N 6"]:
    """What a concealer asks of every anchor: place, expected size, logarithms of how far features and lengths are off.

    The twin of the last two is `splatwire.conceal.scene_free.signature`; the spread of features is the expected
    one, which is known before anything arrives.
    """
    prior = to_arrays(partial[Prior])
    features = prior.feature
    spread = np.sqrt(features.mean.var(axis=0) + (features.scale**2).mean(axis=0))
    feature = features.scale @ (1 / np.maximum(spread, 1e-6)) / len(spread)
    length = prior.scaling.scale.mean(axis=1) / np.maximum(np.abs(prior.scaling.mean).mean(axis=1), SMALLEST)
    doubts = [np.log(np.clip(value, *limits)) for value, limits in zip((feature, length), _DOUBTS, strict=True)]
    size = np.exp(prior.expected_log_sizes())
    return np.concatenate([to_numpy(partial.scene.positions), np.stack([size, *doubts], axis=1)], axis=1)


def rows_of(anchors: Anchors, ranks: Int64[np.ndarray, "n"]) -> bytes:
    """Payload of the packet that holds some anchors.

    Returns:
        For each anchor float32 features, scale (the largest of three), mean logarithm of the three, sizes, offsets in
        units of the scale; then for each a byte per offset, 1 where it exists.
    """
    some = to_arrays(anchors).select(ranks)
    scales = np.maximum(some.scalings[:, :3], np.float32(SMALLEST))
    largest = scales.max(axis=1)
    offsets = some.offsets * (some.scalings[:, :3] / largest[:, None])[:, None]
    form = np.stack([largest, np.log(scales).mean(axis=1)], axis=1)
    rows = np.concatenate([some.features, form, some.scalings[:, 3:], offsets.reshape(len(ranks), -1)], axis=1)
    return _float_bytes(rows) + some.mask.astype(np.uint8).tobytes()


def _copies(partial: Partial[AnchorScene], section: bytes) -> bytes:
    """The anchors of a sketch, and the growth around them."""
    sketch = read_sketch(section, sizes_of(partial), buckets_of(partial))
    ranks = np.flatnonzero(sketch.levels > 0)
    nothing = partial.without(np.zeros(partial.scene.num_elements, np.bool_))
    drawn = with_sketch(nothing, sketch).scene.anchors
    writer = ByteWriter()
    for value in (sketch.exponent, sketch.max_excess, sketch.trust):
        writer.f32(value)
    writer.unsigned(len(ranks))
    return (
        writer.bytes() + ranks.astype("<u4").tobytes() + _float_bytes(drawn.positions[ranks])
        + rows_of(drawn, ranks)
    )  # fmt: skip


def _mlp_bytes(mlp: Mlp) -> bytes:
    writer = ByteWriter()
    writer.unsigned(len(mlp.hidden.bias))
    writer.f32(mlp.negative_slope)
    layers = (mlp.hidden.weight, mlp.hidden.bias, mlp.output.weight, mlp.output.bias)
    return writer.bytes() + b"".join(map(_float_bytes, layers))


def _float_bytes(values: np.ndarray) -> bytes:
    return values.astype("<f4").tobytes()
