"""The decoded attributes of a set of anchors."""

import dataclasses
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.scene.attributes import AnchorLayout


@dataclass(frozen=True, eq=False)
class Anchors:
    """N anchors with K offsets and F feature channels each, on any device.

    Attributes:
        positions: World coordinates.
        features: Anchor features.
        scalings: Linear (not logarithmic) sizes: the first three scale the offsets, the last three are the base size
            of the Gaussians.
        offsets: Gaussian centres relative to the anchor, in units of `scalings[:, :3]`; zero where masked out.
        mask: True where the offset's Gaussian exists.
    """

    positions: Float[Tensor, "N 3"]
    features: Float[Tensor, "N F"]
    scalings: Float[Tensor, "N 6"]
    offsets: Float[Tensor, "N K 3"]
    mask: Bool[Tensor, "N K"]

    @property
    def num_anchors(self) -> int:
        """Number of anchors, N."""
        return int(self.positions.shape[0])

    def matches(self, layout: AnchorLayout) -> bool:
        """Tells whether the tensors have the sizes of `layout`."""
        return self.features.shape[1] == layout.feature_dim and self.mask.shape[1] == layout.num_offsets

    def select(self, index: Tensor) -> "Anchors":
        """Returns the anchors at `index` (integers or a boolean mask over N), in that order."""
        return Anchors(**{f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)})

    def arrived(self, known: Bool[Tensor, "N"], guessed: Float[Tensor, "N 3"] | None) -> "Anchors":
        """Returns what a receiver has when only some of them came: of the others nothing but where they are guessed.

        Args:
            known: Which came.
            guessed: Where the others stand; None where places are known from the start.
        """

        def gap(values: Tensor, instead: Tensor | None = None) -> Tensor:
            there = known.view(-1, *[1] * (values.dim() - 1))
            return torch.where(there, values, torch.zeros_like(values) if instead is None else instead)

        positions = self.positions if guessed is None else gap(self.positions, guessed)
        return Anchors(positions, gap(self.features), gap(self.scalings), gap(self.offsets), gap(self.mask))

    def to(self, device: torch.device | str) -> "Anchors":
        """Returns the same anchors on `device`."""
        return Anchors(**{f.name: getattr(self, f.name).to(device) for f in dataclasses.fields(self)})
