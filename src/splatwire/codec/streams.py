"""Scenes to streams and back, by the schema of their elements."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from splatwire.codec.background import read_background
from splatwire.codec.decoding import decode_anchors
from splatwire.codec.encoding import encode_anchors
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.progressive import ProgressiveDecoder as ProgressiveAnchors
from splatwire.codec.schemas.gaussians.copies import SECTION as SKETCH
from splatwire.codec.schemas.gaussians.copies import read_copies
from splatwire.codec.schemas.gaussians.decoder import decode_splats, open_side_info
from splatwire.codec.schemas.gaussians.encoder import encode_splats
from splatwire.codec.schemas.gaussians.progressive import ProgressiveSplats
from splatwire.codec.schemas.gaussians.quality import quality_of
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model import AnchorScene, CausalCoding, PartialSplats, SplatScene
from splatwire.model.appearance import Partial, Scene
from splatwire.packets import ANCHORS, CAUSAL, GAUSSIANS, PRESETS, Manifest, PacketIntake, Packetization, SceneStream
from splatwire.scene import Erasures

Progress = Callable[[float], None]


def codec_of(scene: Scene) -> str:
    """The schema that codes a scene, as a manifest names it."""
    if isinstance(scene, SplatScene):
        return GAUSSIANS
    return CAUSAL if isinstance(scene.coding, CausalCoding) else ANCHORS


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

    Anchors without a single existing offset draw nothing and are not coded, as in HAC++ (HACPP_SPEC 2).

    Args:
        scene: The scene; its render hints are not coded.
        packetization: How its elements are split; None for what `packetization_named` takes without a name.
        tiers: Tier of each element, 0 for the most important (`Importance.tiers`): each tier gets packets of its own,
            so that it can be protected on its own. None for one tier. Decoded values stay the same.
        quality: How finely explicit Gaussians are quantised, `small`, `default` (where absent) or `near-lossless`.
        classes: Class of precision of each explicit Gaussian (`splatwire.render.precision`); None for the finest
            everywhere. Anchors have steps of their own.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite or too large, a tier is empty, the
            packetization or an option is not for these elements, or `scene` is none.
        UnknownNameError: If there is no such quality.
    """
    if isinstance(scene, SplatScene):
        return encode_splats(
            scene.splats, packetization or PRESETS["paper"], background=scene.background, classes=classes,
            quality=quality_of(quality or "default"), tiers=None if tiers is None else tiers.numpy(), threads=threads,
            progress=progress,
        )  # fmt: skip
    check_kind(scene, AnchorScene, "load_scene")
    if quality is not None or classes is not None:
        raise InvalidValueError("qualities and classes of precision are for explicit Gaussians: anchors have own steps")
    return encode_anchors(scene, packetization, tiers=tiers, threads=threads, progress=progress)


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
    if stream.manifest.codec != GAUSSIANS:
        return decode_anchors(stream, threads=threads, progress=progress)
    splats, known, sections = decode_splats(stream, threads=threads, progress=progress)
    left = concealer_sections(sections)
    scene = SplatScene(splats, background=read_background(sections))
    copies = read_copies(open_side_info(stream.manifest, stream.side_info), len(known)) if SKETCH in sections else None
    return PartialSplats(scene, Erasures.of_anchors(torch.from_numpy(known)), left, copies)


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
    if manifest.codec == GAUSSIANS:
        return ProgressiveSplats(manifest, side_info, intake=intake)
    return ProgressiveAnchors(manifest, side_info, intake=intake, progress=progress)
