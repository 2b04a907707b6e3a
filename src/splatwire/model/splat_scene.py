"""Scenes of explicit Gaussians: every view sees the same ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

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

    ELEMENTS: ClassVar[str] = "Gaussians"
    """What its elements are called."""
    splats: Splats
    hints: RenderHints | None = None
    background: Background = BLACK

    @property
    def elements(self) -> Splats:
        """Its elements."""
        return self.splats

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """Where its elements are."""
        return self.splats.means

    @property
    def num_elements(self) -> int:
        """Number of its elements, N."""
        return self.splats.num_gaussians

    def select(self, index: Tensor) -> "SplatScene":
        """The scene with the elements at `index` (integers or a boolean mask over N), hints left out."""
        return replace(self, splats=self.splats.select(index), hints=None)

    @property
    def drawable(self) -> Bool[Tensor, "N"]:
        """Elements that any view can draw: those that are worth a packet."""
        return torch.ones(self.num_elements, dtype=torch.bool)

    @property
    def num_gaussians(self) -> int:
        """Gaussians that its elements can have in a view: themselves."""
        return self.splats.num_gaussians

    def drawn(self) -> Splats:
        """The Gaussians as the hints say: some left out, sizes and opacities times their gains."""
        if self.hints is None:
            return self.splats
        kept, hints = ~self.hints.left_out, self.hints
        splats = replace(self.splats, scales=self.splats.scales * hints.size_gain[:, None])
        if hints.opacity_gain is not None:
            splats = replace(splats, opacities=(splats.opacities * hints.opacity_gain).clamp(max=1))
        return splats.select(kept)


@dataclass(frozen=True, eq=False)
class Copies:
    """Copies of some Gaussians that came apart from packets, and how best to draw a scene that has them.

    Attributes:
        places: Which Gaussians these are, all different.
        splats: The copies.
        growth: Where packets are lost, what the sender found best for it: exponents of size and opacity over the share
            that is lost, and how much of the scene-free network's change of them is taken.
    """

    places: Int64[Tensor, "C"]
    splats: Splats
    growth: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PartialSplats:
    """What a decoder returns for explicit Gaussians, of which some may be lost.

    Attributes:
        scene: The scene; a lost Gaussian has the place and size that are expected of it, and no opacity.
        erasures: What was received.
        concealment: Named sections of the side information: what a sender left for concealers.
        copies: Copies of some Gaussians, where the side information has such a section.
    """

    scene: SplatScene
    erasures: Erasures
    concealment: Mapping[str, bytes] = field(default_factory=dict)
    copies: Copies | None = None

    def without(self, known: Bool[Tensor, "N"]) -> "PartialSplats":
        """The same scene when only some Gaussians are there; the lost ones are expected where, and as, they were."""
        splats = self.scene.splats
        there = replace(splats, opacities=torch.where(known, splats.opacities, torch.zeros_like(splats.opacities)))
        return replace(self, scene=replace(self.scene, splats=there), erasures=Erasures.of_anchors(known))

    def with_copies(self) -> "PartialSplats":
        """The same scene when lost Gaussians of which there are copies count as received; all others stay."""
        if self.copies is None:
            return self
        lost = ~self.erasures.known[self.copies.places]
        places, chosen = self.copies.places[lost], self.copies.splats.select(lost)
        splats = {n: t.index_put((places,), getattr(chosen, n)) for n, t in vars(self.scene.splats).items()}
        received = self.erasures.received.index_put((places,), torch.tensor(True))
        return replace(self, scene=replace(self.scene, splats=Splats(**splats)), erasures=Erasures(received))
