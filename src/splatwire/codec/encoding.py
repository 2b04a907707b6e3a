"""Encodes scenes to streams, for all kinds of scenes."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from splatwire.anchors.appearance import as_scene
from splatwire.arguments import array_of, check_threads, checked, checked_except
from splatwire.bitstream import (
    PRESETS,
    Packet,
    Packetization,
    SceneStream,
    make_packet,
    make_stream,
    packetization_named,
)
from splatwire.bitstream.limits import MAX_TIERS
from splatwire.codec.registry import schema_named, schema_of
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.threads import ordered_map
from splatwire.errors import InvalidValueError, check_progress, shown
from splatwire.ops.threads import limit_threads, one_blas_thread
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats
from splatwire.version import __version__

Progress = Callable[[float], None]


@checked_except("packetization", "progress", "threads", "scene")
def encode_scene(
    scene: Scene | ReceivedScene | Splats,
    packetization: Packetization | str | None = None,
    *,
    tiers: np.ndarray | None = None,
    quality: object = None,
    class_offsets: np.ndarray | None = None,
    network_tolerance: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SceneStream:
    """Encodes a scene into independently decodable packets.

    Only with separated packaging (preset `hacpp`), a feature group also needs those before it.

    This follows Section 3.2 of the paper that this project implements (docs/paper-map.md). Elements that draw nothing
    or cannot be drawn are skipped.

    Args:
        scene: The scene, or any argument of `as_scene`.
        packetization: Division into packets, or the name of a preset such as `datagram`; None for the default.
        tiers: Importance tier of each element, integers (N), 0 for the most important (`Importance.tiers`). Each tier
            gets separate packets, which can be protected separately. None for one tier.
        quality: Quantisation of explicit Gaussians: 0 to 100, `small`, `default` (also for None), `near-lossless`, or a
            `Quality` of their schema.
        class_offsets: Class offset of each explicit Gaussian: its precision class relative to the finest one; 0 for
            the finest, negative for coarser ones (`splatwire.render.precision`). None for the finest. Not for anchors.
        network_tolerance: Only for anchors: how much rounding of weights may change the outputs of the context
            networks, relative to the predicted standard deviations; None for the default.
        threads: Number of threads, which does not affect the result; None for one per processor.
        progress: Called with the completed fraction of the work, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If `scene` is not a scene or empty, values are too large, a tier is empty, or an option does
            not apply to these elements.
        UnknownNameError: If the quality is unknown.
    """
    # If both quality and class offsets are None, a decoded scene is encoded to the same integers. Factors on size and
    # opacity that a loss concealer has set are not encoded. Skipped elements are logged.
    scene = as_scene(scene)
    check_progress(progress)
    check_threads(threads)
    with limit_threads(threads):
        schema, validity = schema_of(scene), scene.validity()
    validity.log_removed("encoding", scene.ELEMENTS)
    if isinstance(packetization, str):
        packetization = packetization_named(packetization, schema.name, int(validity.kept.sum()))
    if packetization is not None and not isinstance(packetization, Packetization):
        raise InvalidValueError(
            f"packetization: expected a Packetization or the name of a preset, not {shown(packetization)}"
        )
    limits, count = (
        {"tiers": (tiers, 0, MAX_TIERS - 1), "class_offsets": (class_offsets, -128, 127)},
        scene.num_elements,
    )
    per_element = {
        name: None if values is None else array_of(values, name, (count,), "i", low, high)
        for name, (values, low, high) in limits.items()
    }
    if not validity.all_drawable:
        kept, scene = validity.kept, scene.select(validity.kept)
        per_element = {name: None if values is None else values[kept] for name, values in per_element.items()}
    options = Options(
        packetization, quality=quality, network_tolerance=network_tolerance, threads=threads, **per_element
    )
    with limit_threads(threads), one_blas_thread():
        prepared = schema.prepare(scene, options)
    return encode_prepared(schema, prepared, threads, progress)


@checked
def repack(
    stream: SceneStream, packetization: Packetization, *, threads: int | None = None, progress: Progress | None = None
) -> SceneStream:
    """Divides a stream into other packets, without changing the decoded scene.

    Args:
        stream: The complete stream; its tiers and named sections are kept.
        packetization: Parameters of the new division into packets.
        threads: Number of threads, which does not affect the result; None for one per processor.
        progress: Called with the completed fraction of the work, 0 to 1.

    Raises:
        InvalidValueError: If packets are missing, or the packetization does not apply to these elements.
        BitstreamError: If the stream contradicts itself.
    """
    missing = stream.manifest.num_packets - len(stream.packets)
    if missing:
        raise InvalidValueError(f"{missing} packets are missing: only a complete stream can be put into other packets")
    schema = schema_named(stream.manifest.schema_name)
    if schema.prepare_repack is None:
        raise InvalidValueError(f"packets of {stream.manifest.elements} cannot be changed: encode the scene again")
    if not stream.manifest.num_packets:  # an update that only removes Gaussians
        return make_stream(
            packetization=packetization, num_elements=0, side_info=stream.side_info, packets=(),
            symbols_digest=stream.manifest.symbols_digest, writer=f"splatwire {__version__}", schema_name=schema.name,
        )  # fmt: skip
    packed = encode_prepared(schema, schema.prepare_repack(stream, packetization, threads), threads, progress)
    return schema.remap_sections(stream, packed)


@checked
def into_datagrams(stream: SceneStream, progress: Progress | None = None) -> SceneStream:
    """Divides a stream into packets that each fit into one datagram.

    Args:
        stream: The complete stream.
        progress: Called with the completed fraction of the work, 0 to 1.

    Raises:
        InvalidValueError: If packets are missing, or the stream cannot be repacketized.
    """
    packed = PRESETS["datagram"]
    if stream.manifest.schema.tiled:
        packed = replace(packed, block_size=stream.manifest.packetization.block_size)
    return repack(stream, packed, progress=progress)


@checked
def can_repack(stream: SceneStream) -> bool:
    """True if a stream can be divided into other packets."""
    # False for Gaussians of older releases, whose decoded integers depend on the split into packets.
    schema = schema_named(stream.manifest.schema_name)
    return schema.prepare_repack is not None and schema.can_repack(stream)


def encode_prepared(schema: Schema, prepared: Prepared, threads: int | None, progress: Progress | None) -> SceneStream:
    """Encodes all packets of a prepared scene, and returns the stream.

    Args:
        schema: Codec of the scene.
        prepared: The prepared scene.
        threads: Number of threads, which does not affect the result; None for one per processor.
        progress: Called with the completed fraction of the work, 0 to 1; None for no calls.
    """
    plan, digest, packets = prepared.plan, hashlib.sha256(), list[Packet]()
    hashed, encoder, num_encoded = plan.packetization.hashed, prepared.encoder, 0
    ids = () if hashed else plan.ids
    for coded in ordered_map(encoder.encode, encoder.batches(), threads):
        schema.update_digest(digest, coded.decoded_rows)
        for count, payload in zip(coded.counts.tolist(), coded.payloads, strict=True):
            # The id of a hashed packet follows from the index of its first element.
            packet_id = plan.id_of_hashed(num_encoded) if hashed else ids[len(packets)]
            packets.append(make_packet(packet_id, count, payload))
            num_encoded += count
        if progress:
            progress(num_encoded / plan.num_elements if hashed else len(packets) / len(ids))
    _check_sizes(plan.packetization, packets, schema.elements)
    return make_stream(
        packetization=plan.packetization, num_elements=plan.num_elements, side_info=prepared.side_info,
        packets=_consume(packets), symbols_digest=digest.hexdigest(), writer=f"splatwire {__version__}",
        tiers=plan.tiers, schema_name=schema.name, **prepared.manifest_fields,
    )  # fmt: skip


def _check_sizes(packetization: Packetization, packets: list[Packet], elements: str) -> None:
    """Checks that no packet exceeds the size limit of the packetization.

    Args:
        packetization: Parameters of the division into packets, with the limit.
        packets: All packets of the stream.
        elements: Name of the elements in the error message, e.g. "anchors".
    """
    # This happens if a single element is larger than the limit.
    if not packetization.hashed:
        return
    max_bytes = packetization.packet_bytes
    for packet in packets:
        if packet.num_bytes > max_bytes:
            raise InvalidValueError(
                f"{packet.num_elements} of the {elements} of this scene takes {packet.num_bytes} bytes, "
                f"a packet holds {max_bytes}: choose a larger packet size or another preset"
            )


def _consume(packets: list[Packet]) -> Iterator[Packet]:
    """Yields the packets of a list, and removes each yielded packet from the list to free memory."""
    packets.reverse()
    while packets:
        yield packets.pop()
