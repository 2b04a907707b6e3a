"""The decoded attributes of a set of anchors."""

import dataclasses
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.reprs import summary_repr
from splatwire.scene.attributes import Attribute
from splatwire.scene.erasures import Erasures
from splatwire.scene.shapes import Shape, check_tensors

MIN_SIZE = 1e-9
"""Sizes are kept above this before their logarithm is taken, world units."""
_SMALLEST = 0.05
"""Predicted sizes are kept above this share of their median: a prediction may be negative."""

_SHAPES: dict[str, Shape] = {
    "positions": ("N", 3), "features": ("N", "F"), "scalings": ("N", 6), "offsets": ("N", "K", 3), "mask": ("N", "K"),
}  # fmt: skip


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

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_tensors(self, _SHAPES, boolean=("mask",))

    @property
    def num_anchors(self) -> int:
        """Number of anchors, N."""
        return int(self.positions.shape[0])

    @property
    def present_offsets(self) -> Float[Tensor, "N K 3"]:
        """Offsets, zero where masked out, whatever was there."""
        return torch.where(self.mask[:, :, None], self.offsets, torch.zeros_like(self.offsets))

    def select(self, index: Tensor) -> "Anchors":
        """Returns the anchors at `index` (integers or a boolean mask over N), in that order."""
        return Anchors(**{f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)})

    @property
    def log_sizes(self) -> Float[Tensor, "N"]:
        """Mean logarithm of the sizes of each one's Gaussians."""
        return mean_log_size(self.scalings)

    def arrived(self, known: Bool[Tensor, "N"], places: Float[Tensor, "N 3"]) -> "Anchors":
        """Returns what a receiver has when only some of them came: of the others nothing but where they stand.

        Args:
            known: Which came.
            places: Where the others stand.
        """

        def gap(values: Tensor, instead: Tensor | None = None) -> Tensor:
            there = known.view(-1, *[1] * (values.dim() - 1))
            return torch.where(there, values, torch.zeros_like(values) if instead is None else instead)

        places = gap(self.positions, places)
        return Anchors(places, gap(self.features), gap(self.scalings), gap(self.offsets), gap(self.mask))

    def kept(self, erasures: Erasures, proposed: "Anchors") -> "Anchors":
        """Returns what was received of these, and the rest of `proposed`; what does not exist has no offset."""
        received = erasures.received.to(self.positions.device)

        def merge(attribute: Attribute, decoded: Tensor, filled: Tensor) -> Tensor:
            column = received[:, int(attribute)].view(-1, *[1] * (decoded.dim() - 1))
            return torch.where(column, decoded, filled)

        mask = merge(Attribute.MASK, self.mask, proposed.mask)
        return Anchors(
            self.positions,
            merge(Attribute.FEATURE, self.features, proposed.features),
            merge(Attribute.SCALING, self.scalings, proposed.scalings),
            merge(Attribute.OFFSET, self.offsets, proposed.offsets * mask[:, :, None]),
            mask,
        )

    def to(self, device: torch.device | str) -> "Anchors":
        """Returns the same anchors on `device`."""
        return Anchors(**{f.name: getattr(self, f.name).to(device) for f in dataclasses.fields(self)})


def mean_log_size(scalings: Float[Tensor, "N 6"]) -> Float[Tensor, "N"]:
    """Mean logarithm of the sizes of anchors' Gaussians, given scalings, which may be predicted ones."""
    size = scalings[:, 3:]
    typical = float(size.clamp(min=0).median()) if len(size) else 0.0
    return size.clamp(min=max(_SMALLEST * typical, MIN_SIZE)).log().mean(dim=1)
