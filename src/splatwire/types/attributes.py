"""Coded attributes of an anchor, and the number of channels of each."""

import enum
from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError


class Attribute(enum.IntEnum):
    """The four coded attributes of an anchor."""

    FEATURE = 0
    SCALING = 1
    OFFSET = 2
    MASK = 3


@dataclass(frozen=True)
class AnchorLayout:
    """Number of feature channels and offsets of each anchor.

    Attributes:
        feature_dim: Channels of the anchor feature (F).
        num_offsets: Offsets per anchor, each of which may have a Gaussian (K).
        feature_groups: Sizes of the groups of feature channels that are coded one after another.
    """

    feature_dim: int = 50
    num_offsets: int = 10
    feature_groups: tuple[int, ...] = (10, 10, 10, 10, 10)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.feature_dim < 1 or self.num_offsets < 1 or min(self.feature_groups, default=0) < 1:
            raise InvalidValueError(f"sizes of an anchor layout must be positive: {self}")
        if sum(self.feature_groups) != self.feature_dim:
            raise InvalidValueError(
                f"feature groups {self.feature_groups} do not add up to {self.feature_dim} channels"
            )
