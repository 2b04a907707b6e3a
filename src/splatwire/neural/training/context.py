"""Types and functions that the context models share in training."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.grid import GridCorners, find_corners
from splatwire.neural.training.state import TrainState

Attributes = tuple[Float[Tensor, "_ F"], Float[Tensor, "_ 6"], Float[Tensor, "_ O"]]
"""Features, scalings and flat offsets of some anchors."""
MaskedAttributes = tuple[Attributes, Float[Tensor, "_ K"]]
"""Attributes with which anchors are rendered (noise replaces rounding), and straight-through masks of offsets."""


@dataclass(frozen=True, eq=False)
class SampleBits:
    """Estimated bits of a random sample of anchors.

    The bits are those of features, scalings and offsets and, with the causal model, also of offset masks and positions.

    Attributes:
        bits: Total bits of the sampled anchors; differentiable.
        num_anchors: Size of the sample.
    """

    bits: Float[Tensor, ""]
    num_anchors: int


class AnchorCache:
    """Cache of data derived from anchor positions: the positions, and table rows and weights of the hash grid."""

    # Valid until anchors or the bounding box of the hash grid change.

    def __init__(self, config: TrainConfig) -> None:
        self._config = config
        self._voxels: Tensor | None = None
        self._positions: Tensor | None = None
        self._box: tuple[Tensor, ...] | None = None
        self._corners: GridCorners | None = None

    def positions(self, state: TrainState) -> Float[Tensor, "N 3"]:
        """Returns the positions of the anchors, world units, relative to the scene's origin."""
        if self._positions is None or self._voxels is not state.voxels:
            self._voxels, self._positions, self._corners = state.voxels, state.positions, None
        return self._positions

    def corners(self, state: TrainState) -> GridCorners:
        """Returns the table rows and weights with which the hash grid is interpolated at all anchors."""
        positions = self.positions(state)
        box = (state.bounds_min, state.bounds_max)
        if self._corners is None or self._box is None or any(a is not b for a, b in zip(box, self._box, strict=True)):
            self._box = box
            self._corners = find_corners((positions - box[0]) / (box[1] - box[0]), self._config.hacpp.grid)
        return self._corners


def straight_through_masks(
    state: TrainState, config: TrainConfig, index: Int64[Tensor, "M"]
) -> tuple[Float[Tensor, "M K"], Float[Tensor, "M"]]:
    """Returns the masks of offsets and of anchors as 0 or 1 (as in HAC++).

    Gradients are computed as if the masks were the sigmoids of their logits (straight-through estimator).
    """
    # In the gradient, the mask of an offset is replaced by the sigmoid of its logit, and the mask of an anchor by
    # the mean of these sigmoids over its offsets.
    return straight_through(state.parameters["mask_logits"][index], config.mask_threshold)


def straight_through(logits: Float[Tensor, "M K"], threshold: float) -> tuple[Float[Tensor, "M K"], Float[Tensor, "M"]]:
    """Returns the masks of offsets and of anchors for given mask logits, as 0 or 1.

    Gradients are computed as if the masks were the sigmoids of their logits (straight-through estimator).
    """
    # An offset exists if the sigmoid of its logit is above `threshold`, an anchor if one of its offsets does.
    share = torch.sigmoid(logits)
    hard = (share > threshold).to(share)
    offsets = share + (hard - share).detach()
    mean, any_hard = share.mean(dim=1), hard.amax(dim=1)
    return offsets, mean + (any_hard - mean).detach()
