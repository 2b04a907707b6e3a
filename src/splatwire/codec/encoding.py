"""Scene to stream, whatever its elements are."""

import hashlib
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import UInt8

from splatwire.codec.registry import schema_named, schema_of
from splatwire.codec.schema import Options, Prepared, Schema
from splatwire.codec.threads import ordered_map
from splatwire.errors import InvalidValueError
from splatwire.model.appearance import as_scene
from splatwire.model.partial import Partial
from splatwire.model.scene import Scene
from splatwire.packets import Packet, Packetization, SceneStream, make_packet, make_stream, packetization_named
from splatwire.packets.limits import SCHEMAS
from splatwire.scene.splats import Splats
from splatwire.version import __version__

Progress = Callable[[float], None]


def encode_scene(
    scene: Scene | Partial | Splats,
    packetization: Packetization | str | None = None,
    *,
    tiers: UInt8[np.ndarray, "N"] | None = None,
    quality: object = None,
    classes: np.ndarray | None = None,
    noise: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SceneStream:
    """Encodes a scene into independently decodable packets (paper 3.2).

    Elements that draw nothing (anchors without a single existing offset) or cannot be drawn are not coded, which is
    logged (`splatwire.scene.rows`).

    Args:
        scene: The scene, or what `as_scene` makes one of; its render hints are not coded.
        packetization: How its elements are split, or the name of a preset such as `datagram`; None for what
            `packetization_named` takes without a name.
        tiers: Tier of each element, 0 for the most important (`Importance.tiers`): each tier gets packets of its own,
            so that it can be protected on its own. None for one tier. Decoded values stay the same.
        quality: How finely explicit Gaussians are quantised, `small`, `default` (where absent), `near-lossless`, or a
            `Quality` of their schema.
        classes: Class of precision of each explicit Gaussian (`splatwire.render.precision`); None for the finest
            everywhere. With neither a decoded scene is encoded to the same integers. Anchors have steps of their own.
        noise: Tolerated noise of the networks of anchors (see their schema's `fit`); None for the measured rule.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are too large, a tier is empty, the packetization or
            an option is not for these elements, or `scene` is none.
        UnknownNameError: If there is no such quality.
    """
    scene = as_scene(scene)
    schema, rows = schema_of(scene), scene.rows()
    rows.tell("encoding", scene.ELEMENTS)
    if isinstance(packetization, str):
        packetization = packetization_named(packetization, schema.name, int(rows.kept.sum()))
    if packetization is not None and not isinstance(packetization, Packetization):
        raise InvalidValueError(f"expected a Packetization or the name of a preset, not {packetization!r:.60}")
    per_element = {"tiers": None if tiers is None else np.asarray(tiers), "classes": classes}
    for name, values in per_element.items():
        if values is not None and np.shape(values) != (scene.num_elements,):
            raise InvalidValueError(f"{name} of shape {np.shape(values)} for {scene.num_elements} {scene.ELEMENTS}")
    if not rows.complete:
        kept, scene = rows.kept, scene.select(rows.kept)
        per_element = {name: None if values is None else values[kept] for name, values in per_element.items()}
    options = Options(packetization, quality=quality, noise=noise, threads=threads, **per_element)
    return _encode(schema, schema.prepare(scene, options), threads, progress)


def repack(
    stream: SceneStream, packetization: Packetization, *, threads: int | None = None, progress: Progress | None = None
) -> SceneStream:
    """Puts a stream into other packets, which decode to exactly the same scene.

    Args:
        stream: The complete stream; its tiers and named sections stay.
        packetization: How its elements are split.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Raises:
        InvalidValueError: If packets are missing, or the packetization is not for these elements.
        BitstreamError: If the stream contradicts itself.
    """
    missing = stream.manifest.num_packets - len(stream.packets)
    if missing:
        raise InvalidValueError(f"{missing} packets are missing: only a complete stream can be put into other packets")
    schema = schema_named(stream.manifest.codec)
    packed = _encode(schema, schema.prepare_again(stream, packetization, threads), threads, progress)
    return schema.carried(stream, packed)


def repackable(stream: SceneStream) -> bool:
    """Whether other packets can hold the same integers: not where an older release encoded explicit Gaussians."""
    return schema_named(stream.manifest.codec).repackable(stream)


def _encode(schema: Schema, prepared: Prepared, threads: int | None, progress: Progress | None) -> SceneStream:
    """All packets in the order of the plan, and the digest of what they hold."""
    plan, digest, packets = prepared.plan, hashlib.sha256(), list[Packet]()
    hashed, encoder, held = plan.packetization.hashed, prepared.encoder, 0
    ids = () if hashed else plan.ids
    for coded in ordered_map(encoder.encode, encoder.runs(), threads):
        schema.update_digest(digest, coded.rows)
        for count, payload in zip(coded.counts.tolist(), coded.payloads, strict=True):
            # Packets that were cut by their size are named by the first element that they hold.
            name = plan.name_hashed(held) if hashed else ids[len(packets)]
            packets.append(make_packet(name, count, payload))
            held += count
        if progress:
            progress(held / plan.num_elements if hashed else len(packets) / len(ids))
    _check_sizes(plan.packetization, packets, schema.name)
    return make_stream(
        packetization=plan.packetization, num_elements=plan.num_elements, side_info=prepared.side_info,
        packets=_taken(packets), symbols_digest=digest.hexdigest(), writer=f"splatwire {__version__}",
        tiers=plan.tiers, codec=schema.name, **prepared.stated,
    )  # fmt: skip


def _check_sizes(packetization: Packetization, packets: list[Packet], name: str) -> None:
    """Refuses an element that alone is larger than a packet may be."""
    if not packetization.hashed:
        return
    most = packetization.packet_bytes
    for packet in packets:
        if packet.num_bytes > most:
            raise InvalidValueError(
                f"{packet.num_elements} of the {SCHEMAS[name].elements} of this scene takes {packet.num_bytes} bytes, "
                f"a packet holds {most}: choose a larger packet size or another preset"
            )


def _taken(packets: list[Packet]) -> Iterator[Packet]:
    """Packets from the list, which forgets them: what is made of them takes their place in memory."""
    packets.reverse()
    while packets:
        yield packets.pop()
