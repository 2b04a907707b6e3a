"""The causal context model: what an anchor's numbers are predicted from is its own place and its own numbers before.

Nothing is shared by anchors but the networks, so a packet needs nothing of any other. Numbers are coded in an order:
the feature in groups, the first of which are single channels and serve as latents of all that follows; which offsets
exist, and their common scale; the base size of the Gaussians; the offsets. Each network reads the place and everything
before. All numbers are in quantisation steps here.
"""

from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float

from splatwire.model.networks import Mlp
from splatwire.reprs import summary_repr
from splatwire.scene import AnchorLayout

OCTAVES = 4
"""Frequencies of a coordinate that the position network reads besides the coordinate itself."""
INPUT_UNIT = 0.25
"""What a step counts as where a number is an input of a network."""
FORM = 4
"""Numbers of an anchor's form: the logarithm of the offsets' scale, and those of the base size along three axes."""


@dataclass(frozen=True)
class CausalConfig:
    """Shape of the causal context model.

    Attributes:
        layout: Sizes of an anchor.
        context_dim: Numbers that a place is described by.
    """

    layout: AnchorLayout = field(default_factory=lambda: AnchorLayout(32, 10, (1, 1, 2, 4, 8, 16)))
    context_dim: int = 16

    @property
    def num_steps(self) -> int:
        """Quantisation steps: one for each feature group, then of the scale, the size and the offsets."""
        return len(self.layout.feature_groups) + 3

    def shapes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of every network, in the order in which they are evaluated."""
        features, offsets, c = self.layout.feature_dim, self.layout.num_offsets, self.context_dim
        shapes, before = {"position": (3 * (1 + OCTAVES), c)}, 0
        for group, size in enumerate(self.layout.feature_groups):
            shapes[f"feature{group}"] = (c + before, 2 * size)
            before += size
        shapes["form"] = (c + features, offsets + 2)
        shapes["size"] = (c + features + 1, 6)
        shapes["offset"] = (c + features + FORM, 6 * offsets)
        return shapes


@dataclass(frozen=True, eq=False)
class CausalCoding:
    """What schema `causal` codes a scene with; nothing that draws reads it.

    Attributes:
        networks: The networks of `CausalConfig.shapes`, by name.
        steps: Quantisation steps, in the order of `CausalConfig.num_steps`; those of scale and size are of logarithms.
        centres: What stands for zero of the four logarithms of an anchor's form.
        middle: Middle of the scene, voxels.
        spread: Its extent along each axis, voxels: half of the anchors are about this near to the middle.
        voxel_size: Spacing of anchor positions, world units.
        config: Shapes.
    """

    networks: dict[str, Mlp]
    steps: Float[Any, "S"]
    centres: Float[Any, "4"]
    middle: Float[Any, "3"]
    spread: Float[Any, "3"]
    voxel_size: float
    config: CausalConfig

    __repr__ = summary_repr
