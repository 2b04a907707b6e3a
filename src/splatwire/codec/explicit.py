"""Streams of explicit Gaussians, from and to scenes."""

from collections.abc import Callable

import numpy as np
import torch

from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.codec.background import read_background
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.schemas.gaussians.decoder import decode_splats
from splatwire.codec.schemas.gaussians.encoder import encode_splats
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.model import PartialSplats, SplatScene
from splatwire.packets import Packetization, SceneStream
from splatwire.scene import Erasures


def encode_explicit(
    scene: SplatScene,
    packetization: Packetization,
    *,
    quality: Quality,
    classes: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """Encodes a scene of explicit Gaussians; its render hints are not coded.

    Args:
        scene: The scene.
        packetization: How its Gaussians are split.
        quality: How finely they are quantised.
        classes: Class of precision of each (`splatwire.render.precision`); None for the finest everywhere.
        progress: Called with the share of the work that is done, 0 to 1.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite, or the packetization is not for this.
    """
    return encode_splats(
        scene.splats, packetization, background=scene.background, classes=classes, quality=quality, progress=progress
    )


def decode_explicit(stream: SceneStream, *, progress: Callable[[float], None] | None = None) -> PartialSplats:
    """Decodes what arrived of a stream of explicit Gaussians.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the stream contradicts itself, or holds something else.
        DesyncError: If nothing was lost and yet the decoded integers are not those that were encoded.
    """
    splats, known, sections = decode_splats(stream, progress=progress)
    left = {name: data for name, data in sections.items() if name not in (BACKGROUND, TIERS, PREVIEW)}
    scene = SplatScene(splats, background=read_background(sections))
    return PartialSplats(scene, Erasures.of_anchors(torch.from_numpy(known)), left)
