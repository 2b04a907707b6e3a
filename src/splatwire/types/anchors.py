"""Attributes of anchors, from which small networks compute Gaussians for each view."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError, check_kind, shown
from splatwire.ops.arrays import lower_median, to_numpy, where
from splatwire.reprs import summary_repr
from splatwire.types.attributes import Attribute
from splatwire.types.loss_mask import LossMask
from splatwire.types.shapes import Shape, check_arrays, check_mask, indices_of

MIN_SIZE = 1e-9
"""Lower bound of sizes before their logarithm is taken, world units."""
_SMALLEST = 0.05
"""Lower bound of predicted Gaussian sizes as a fraction of their median, because a prediction may be negative."""

_SHAPES: dict[str, Shape] = {
    "positions": ("N", 3), "features": ("N", "F"), "scalings": ("N", 6), "offsets": ("N", "K", 3), "mask": ("N", "K"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Anchors:
    """Attributes of N anchors with K offsets and F feature channels each.

    Fields are numpy arrays, or torch tensors during training.

    Attributes:
        positions: World units, relative to the scene's origin.
        features: Anchor features.
        scalings: Sizes (not logarithms): the first three scale the offsets, the last three are the base size of the
            Gaussians.
        offsets: Gaussian centres relative to the anchor, in units of `scalings[:, :3]`; zero where masked out.
        mask: True where the offset's Gaussian exists.
    """

    positions: Float[Any, "N 3"]
    features: Float[Any, "N F"]
    scalings: Float[Any, "N 6"]
    offsets: Float[Any, "N K 3"]
    mask: Bool[Any, "N K"]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_fields(self)
        check_arrays(self, _SHAPES, boolean=("mask",), positions="positions")

    @property
    def num_anchors(self) -> int:
        """Number of anchors, N."""
        return int(self.positions.shape[0])

    @property
    def present_offsets(self) -> Float[Any, "N K 3"]:
        """Offsets, with masked-out offsets set to zero."""
        return where(self.mask[:, :, None], self.offsets, 0)

    def select(self, index: Any) -> "Anchors":
        """Returns the anchors at `index` (integers, a boolean mask over N or a slice), in that order.

        Raises:
            InvalidValueError: If an index is out of range, or a mask has another length.
        """
        chosen = indices_of(index, self.num_anchors)
        if isinstance(index, slice) or hasattr(index, "is_floating_point"):  # views, and indices on the device
            chosen = index
        return Anchors(**{f.name: getattr(self, f.name)[chosen] for f in dataclasses.fields(self)})

    @property
    def log_sizes(self) -> Float[Any, "N"]:
        """Logarithm of the geometric mean of each anchor's three base Gaussian sizes (world units)."""
        return mean_log_size(self.scalings)

    def with_losses(self, fully_received: Bool[Any, "N"], positions: Float[Any, "N 3"]) -> "Anchors":
        """Simulates losses: moves lost anchors to `positions`, and sets all other attributes of lost anchors to 0.

        Args:
            fully_received: Mask of received anchors.
            positions: Positions for the lost anchors, world units, relative to the scene's origin. Other rows are
                ignored.

        Raises:
            InvalidValueError: If an array has another shape or type.
        """
        check_mask(fully_received, self.num_anchors, "fully_received")
        if tuple(getattr(positions, "shape", ())) != (self.num_anchors, 3):
            raise InvalidValueError(
                f"positions: expected a float32 array ({self.num_anchors:,}, 3), not {shown(positions)}"
            )

        def gap(values: Any, instead: Any = 0) -> Any:
            return where(fully_received.reshape(-1, *[1] * (values.ndim - 1)), values, instead)

        positions = gap(self.positions, positions)
        return Anchors(positions, gap(self.features), gap(self.scalings), gap(self.offsets), gap(self.mask))

    def with_estimates(self, loss_mask: LossMask, estimates: "Anchors") -> "Anchors":
        """Returns the anchors with lost attributes replaced by estimates.

        Args:
            loss_mask: Mask of received attributes.
            estimates: All anchors, with estimates of lost attributes.

        Raises:
            InvalidValueError: If an argument has another type, or is for other numbers of anchors, channels or offsets.
        """
        check_kind(loss_mask, LossMask, "decode_stream(...).loss_mask", "loss_mask")
        check_kind(estimates, Anchors, "open_scene(...).anchors", "estimates")
        check_mask(loss_mask.fully_received, self.num_anchors, "loss_mask")
        shapes = [tuple(getattr(one, name).shape for name in _SHAPES) for one in (self, estimates)]
        if shapes[0] != shapes[1]:
            raise InvalidValueError(f"estimates: arrays of shapes {shapes[1]}, not {shapes[0]}")
        received = loss_mask.received

        def merge(attribute: Attribute, decoded: Any, filled: Any) -> Any:
            return where(received[:, int(attribute)].reshape(-1, *[1] * (decoded.ndim - 1)), decoded, filled)

        mask = merge(Attribute.MASK, self.mask, estimates.mask)
        return Anchors(
            self.positions,
            merge(Attribute.FEATURE, self.features, estimates.features),
            merge(Attribute.SCALING, self.scalings, estimates.scalings),
            merge(Attribute.OFFSET, self.offsets, estimates.offsets * mask[:, :, None]),
            mask,
        )


def mean_log_size(scalings: Float[Any, "N 6"]) -> Float[Any, "N"]:
    """Returns the mean logarithm of the three base Gaussian sizes of each anchor, from its scalings."""
    size = to_numpy(scalings)[:, 3:]
    typical = float(lower_median(np.maximum(size, 0).ravel())) if len(size) else 0.0
    return np.log(np.maximum(size, size.dtype.type(max(_SMALLEST * typical, MIN_SIZE)))).mean(axis=1)
