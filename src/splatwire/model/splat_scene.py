"""Scenes of explicit Gaussians: every view sees the same ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from splatwire.model.anchor_scene import RenderHints
from splatwire.scene import Erasures
from splatwire.scene.background import BLACK, Background
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class SplatScene:
    """Explicit Gaussians that can be drawn and encoded.

    Attributes:
        splats: The Gaussians.
        hints: Render-time hints of a concealer, if one worked on the scene.
        background: RGB behind everything.
    """

    splats: Splats
    hints: RenderHints | None = None
    background: Background = BLACK


@dataclass(frozen=True, eq=False)
class PartialSplats:
    """What a decoder returns for explicit Gaussians, of which some may be lost.

    Attributes:
        scene: The scene; a lost Gaussian has the place and size that are expected of it, and no opacity.
        erasures: What was received.
        concealment: Named sections of the side information: what a sender left for concealers.
    """

    scene: SplatScene
    erasures: Erasures
    concealment: Mapping[str, bytes] = field(default_factory=dict)
