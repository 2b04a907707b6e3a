"""Scenes to streams and back, by the schema of their elements."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from splatwire.codec.background import read_background
from splatwire.codec.decoding import decode_anchors
from splatwire.codec.encoding import encode_anchors, repack_anchors
from splatwire.codec.memory import allocating
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.progressive import ProgressiveDecoder as ProgressiveAnchors
from splatwire.codec.schemas.gaussians.copies import SECTION as SKETCH
from splatwire.codec.schemas.gaussians.copies import moved_copies, read_copies
from splatwire.codec.schemas.gaussians.decoder import decode_gaussians, open_side_info
from splatwire.codec.schemas.gaussians.encoder import encode_splats
from splatwire.codec.schemas.gaussians.progressive import ProgressiveSplats
from splatwire.codec.schemas.gaussians.quality import quality_of
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model import AnchorScene, CausalCoding, ExpectedPlaces, Prior, SplatScene
from splatwire.model.appearance import Partial, Scene
from splatwire.packets import ANCHORS, CAUSAL, GAUSSIANS, PRESETS, Manifest, PacketIntake, Packetization, SceneStream
from splatwire.packets.sections import add_concealment
from splatwire.scene import AnchorLayout, Anchors, Erasures
from splatwire.scene.splats import Splats

Progress = Callable[[float], None]


def codec_of(scene: Scene) -> str:
    """The schema that codes a scene, as a manifest names it."""
    if isinstance(scene, SplatScene):
        return GAUSSIANS
    return CAUSAL if isinstance(getattr(scene, "coding", None), CausalCoding) else ANCHORS


def _explicit(manifest: Manifest) -> bool:
    return manifest.codec == GAUSSIANS


def encode_scene(
    scene: Scene,
    packetization: Packetization | None = None,
    *,
    tiers: UInt8[Tensor, "N"] | None = None,
    quality: str | None = None,
    classes: np.ndarray | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SceneStream:
    """Encodes a scene into independently decodable packets (paper 3.2).

    Elements that draw nothing (anchors without a single existing offset, as in HAC++, HACPP_SPEC 2) or cannot be drawn
    are not coded, which is logged (`splatwire.scene.rows`).

    Args:
        scene: The scene; its render hints are not coded.
        packetization: How its elements are split; None for what `packetization_named` takes without a name.
        tiers: Tier of each element, 0 for the most important (`Importance.tiers`): each tier gets packets of its own,
            so that it can be protected on its own. None for one tier. Decoded values stay the same.
        quality: How finely explicit Gaussians are quantised, `small`, `default` (where absent) or `near-lossless`.
        classes: Class of precision of each explicit Gaussian (`splatwire.render.precision`); None for the finest
            everywhere. With neither a decoded scene is encoded to the same integers. Anchors have steps of their own.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are too large, a tier is empty, the packetization or
            an option is not for these elements, or `scene` is none.
        UnknownNameError: If there is no such quality.
    """
    if isinstance(scene, SplatScene):
        rows, tier_of = scene.rows(), None if tiers is None else tiers.numpy()
        rows.tell("encoding", scene.ELEMENTS)
        if not rows.complete:
            kept, scene = rows.kept.numpy(), scene.select(rows.kept)
            tier_of, classes = (None if of is None else np.asarray(of)[kept] for of in (tier_of, classes))
        again = scene.coding if quality is None and classes is None else None
        return encode_splats(
            scene.splats, packetization or PRESETS["paper"], background=scene.background, classes=classes,
            quality=quality_of(quality or "default"), tiers=tier_of, coding=again,
            threads=threads, progress=progress,
        )  # fmt: skip
    check_kind(scene, AnchorScene, "open_scene")
    scene.rows().tell("encoding", scene.ELEMENTS)
    if quality is not None or classes is not None:
        raise InvalidValueError("qualities and classes of precision are for explicit Gaussians: anchors have own steps")
    assert isinstance(scene, AnchorScene)
    return encode_anchors(scene, packetization, tiers=tiers, threads=threads, progress=progress)


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
    if not _explicit(stream.manifest):
        return repack_anchors(stream, packetization, threads=threads, progress=progress)
    return _repack_splats(stream, packetization, threads, progress)


def repackable(stream: SceneStream) -> bool:
    """Whether other packets can hold the same integers: not where an older release encoded explicit Gaussians."""
    if not _explicit(stream.manifest):
        return True
    return open_side_info(stream.manifest, stream.side_info).coarsest >= 0


def _repack_splats(
    stream: SceneStream, packetization: Packetization, threads: int | None, progress: Progress | None
) -> SceneStream:
    if not repackable(stream):
        raise InvalidValueError(
            "an older release encoded these Gaussians, and their integers are bound to their packets: "
            "encode the scene again"
        )
    found, shapes = decode_gaussians(stream, threads=threads), stream.manifest.tiers
    tiers = np.repeat(np.arange(len(shapes), dtype=np.uint8), [shape.num_anchors for shape in shapes])
    packed = encode_splats(
        found.splats, packetization, background=read_background(found.info.sections), tiers=tiers if shapes else None,
        coding=found.coding, like=found.info, threads=threads, progress=progress,
    )  # fmt: skip
    if SKETCH not in found.info.sections:
        return packed
    place_at = np.empty(len(found.known), dtype=np.int64)
    place_at[_ranked(found.splats)] = _ranked(decode_gaussians(packed, threads=threads).splats)
    return add_concealment(packed, SKETCH, moved_copies(found.info.sections[SKETCH], place_at))


def _ranked(splats: Splats) -> np.ndarray:
    """Gaussians in an order that depends on nothing but themselves, int64 (N)."""
    columns = [values.numpy().reshape(splats.num_gaussians, -1) for values in vars(splats).values()]
    return np.lexsort(np.concatenate(columns, axis=1).T)


def decode_stream(stream: SceneStream, *, threads: int | None = None, progress: Progress | None = None) -> Partial:
    """Decodes what arrived of a stream.

    Args:
        stream: The stream; packets may be missing, side information may not.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The scene and what of it is there: anchors by rank with the prior of each, or explicit Gaussians by place.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the stream contradicts itself.
        InvalidValueError: If `stream` is none.
        DesyncError: If nothing was lost and yet the decoded integers are not those that were encoded.
    """
    check_kind(stream, SceneStream, "read_stream")
    if not _explicit(stream.manifest):
        return decode_anchors(stream, threads=threads, progress=progress)
    with allocating(f"decoding {stream.manifest.num_anchors:,} Gaussians"):
        found = decode_gaussians(stream, threads=threads, progress=progress)
    sections, known = found.info.sections, found.known
    left = concealer_sections(sections)
    scene = SplatScene(found.splats, background=read_background(sections), coding=found.coding)
    copies = read_copies(open_side_info(stream.manifest, stream.side_info), len(known)) if SKETCH in sections else None
    said = () if copies is None else (copies,)
    return Partial(scene, Erasures.of_anchors(torch.from_numpy(known)), left, said)


_OFFERS: Mapping[str, frozenset[type]] = {
    ANCHORS: frozenset((Anchors, Prior, AnchorLayout)),
    CAUSAL: frozenset((Anchors, Prior, AnchorLayout, ExpectedPlaces)),
    GAUSSIANS: frozenset((Splats,)),
}


def offers_of(codec: str) -> frozenset[type]:
    """Kinds of records that a concealer finds in every decoded stream of a schema (`Partial.offers`)."""
    return _OFFERS[codec]


ProgressiveDecoder: TypeAlias = ProgressiveAnchors | ProgressiveSplats
"""Decodes a stream while it arrives."""


def progressive_decoder(
    manifest: Manifest, side_info: bytes, *, intake: PacketIntake | None = None, progress: Progress | None = None
) -> ProgressiveDecoder:
    """Gets ready to decode a stream while it arrives.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        intake: What its packets passed where they arrived; None lets them pass one here.
        progress: Called with the share of the preparation that is done, 0 to 1.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it contradicts the manifest.
    """
    if _explicit(manifest):
        return ProgressiveSplats(manifest, side_info, intake=intake)
    return ProgressiveAnchors(manifest, side_info, intake=intake, progress=progress)
