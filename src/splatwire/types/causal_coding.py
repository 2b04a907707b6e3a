"""Data of the causal context model, which predicts each value of an anchor from its position and its decoded values.

The values of an anchor are coded in this order: the feature channels in groups; the mask of existing offsets and their
common scale; the base size of the Gaussians; the offsets. No anchor is predicted from another one, so each packet
decodes independently. Values are in units of their quantisation steps.
"""

from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float

from splatwire.arguments import CheckedFields
from splatwire.lazy_names import renamed_attributes
from splatwire.reprs import summary_repr
from splatwire.types.attributes import AnchorLayout
from splatwire.types.networks import Mlp

OCTAVES = 4
"""Number of frequencies per coordinate that the position network reads in addition to the coordinate itself."""
INPUT_UNIT = 0.25
"""Network input value of one quantisation step."""
MASK_AND_SCALE = "form"
"""Name, also in scene files, of the network that predicts the mask of existing offsets and their common scale."""
NUM_LOG_SCALINGS = 4
"""Number of coded logarithms of scalings of an anchor: of the common scale of its offsets, and of the base size of its
Gaussians along three axes."""


@dataclass(frozen=True)
class CausalConfig(CheckedFields):
    """Configuration of the causal context model.

    Attributes:
        layout: Number of feature channels and offsets per anchor.
        context_dim: Length of the output of the network that encodes the anchor position.
    """

    layout: AnchorLayout = field(default_factory=lambda: AnchorLayout(32, 10, (1, 1, 2, 4, 8, 16)))
    context_dim: int = 16

    @property
    def num_steps(self) -> int:
        """Number of quantisation step sizes: one per feature group, then offset scale, base size and offsets."""
        return len(self.layout.feature_groups) + 3

    def shapes(self) -> dict[str, tuple[int, int]]:
        """Returns the numbers of inputs and outputs of every network by name, in evaluation order.

        The outputs of `position` are context features. The outputs of the other networks are means, then log2 of
        standard deviations; with `MASK_AND_SCALE`, the logits of the offset masks come first.
        """
        features, offsets, c = self.layout.feature_dim, self.layout.num_offsets, self.context_dim
        shapes, before = {"position": (3 * (1 + OCTAVES), c)}, 0
        for group, size in enumerate(self.layout.feature_groups):
            shapes[f"feature{group}"] = (c + before, 2 * size)
            before += size
        shapes[MASK_AND_SCALE] = (c + features, offsets + 2)
        shapes["size"] = (c + features + 1, 6)
        shapes["offset"] = (c + features + NUM_LOG_SCALINGS, 6 * offsets)
        return shapes


@dataclass(frozen=True, eq=False)
class CausalCoding(CheckedFields):
    """Networks and quantisation steps of the schema `causal`, unused by renderers.

    Offset scale (one number per anchor) and base size (three numbers, one per axis) are quantised as logarithms.

    Attributes:
        networks: The networks of `CausalConfig.shapes`, by name.
        steps: Quantisation step sizes: one for each feature group, then one each for offset scale, base size and
            offsets.
        zero_points: Values subtracted from the natural logarithms of the offset scale (1 value) and the base size (3
            values) before quantisation. Streams have binary logarithms.
        middle: Median position of the anchors when the context phase of the training began, voxels. Fine-tuning
            does not change it.
        spread: Twice the median distance of the anchors from `middle` along each axis at that time, voxels. The
            distance is rounded up to whole voxels, and counts as at least 1.
        voxel_size: Spacing of anchor positions, world units.
        config: Configuration that determines the layer sizes of the networks.
    """

    networks: dict[str, Mlp]
    steps: Float[Any, "S"]
    zero_points: Float[Any, "4"]
    middle: Float[Any, "3"]
    spread: Float[Any, "3"]
    voxel_size: float
    config: CausalConfig

    __repr__ = summary_repr
    __getattr__ = renamed_attributes("CausalCoding", {"extent": "spread"})
