"""What an anchor holds, and the names of the parts that a packet may lose."""

import enum
from dataclasses import dataclass


class Attribute(enum.IntEnum):
    """The four coded attributes of an anchor; the value is the column in `Erasures`."""

    FEATURE = 0
    SCALING = 1
    OFFSET = 2
    MASK = 3


@dataclass(frozen=True)
class AnchorLayout:
    """Sizes of the attributes of one anchor.

    Attributes:
        feature_dim: Channels of the anchor feature (F).
        num_offsets: Offsets, and therefore possible Gaussians, per anchor (K).
        feature_groups: Sizes of the channel groups that are coded one after another; they add up to `feature_dim`.
    """

    feature_dim: int = 50
    num_offsets: int = 10
    feature_groups: tuple[int, ...] = (10, 10, 10, 10, 10)

    def __post_init__(self) -> None:
        if self.feature_dim < 1 or self.num_offsets < 1 or min(self.feature_groups, default=0) < 1:
            raise ValueError(f"sizes of an anchor layout must be positive: {self}")
        if sum(self.feature_groups) != self.feature_dim:
            raise ValueError(f"feature groups {self.feature_groups} do not add up to {self.feature_dim} channels")
