"""Which attributes of which anchors arrived."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool

from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.scene.attributes import Attribute


@dataclass(frozen=True, eq=False)
class Erasures:
    """What arrived of N anchors, one column per `Attribute`.

    With atomic packaging all columns are equal; attribute-separated streams lose columns one by one.

    Attributes:
        received: True where the attribute of the anchor was received.
    """

    received: Bool[Any, "N 4"]

    __repr__ = summary_repr

    @property
    def known(self) -> Bool[Any, "N"]:
        """Anchors of which every attribute was received."""
        return self.received.all(1)

    @property
    def num_lost(self) -> int:
        """Anchors of which at least one attribute is missing."""
        return int((~self.known).sum())

    def column(self, attribute: Attribute) -> Bool[Any, "N"]:
        """Anchors of which `attribute` was received."""
        return self.received[:, int(attribute)]

    @staticmethod
    def of_anchors(known: Bool[Any, "N"]) -> "Erasures":
        """Builds the erasures of atomic packaging: an anchor is there with all attributes or with none."""
        return Erasures(np.repeat(to_numpy(known)[:, None], len(Attribute), axis=1))
