"""Which attributes of which anchors arrived."""

from dataclasses import dataclass

from jaxtyping import Bool
from torch import Tensor

from splatwire.reprs import summary_repr
from splatwire.scene.attributes import Attribute


@dataclass(frozen=True, eq=False)
class Erasures:
    """What arrived of N anchors, one column per `Attribute`.

    With atomic packaging all columns are equal; attribute-separated streams lose columns one by one.

    Attributes:
        received: True where the attribute of the anchor was received.
    """

    received: Bool[Tensor, "N 4"]

    __repr__ = summary_repr

    @property
    def known(self) -> Bool[Tensor, "N"]:
        """Anchors of which every attribute was received."""
        return self.received.all(dim=1)

    @property
    def num_lost(self) -> int:
        """Anchors of which at least one attribute is missing."""
        return int((~self.known).sum())

    def column(self, attribute: Attribute) -> Bool[Tensor, "N"]:
        """Anchors of which `attribute` was received."""
        return self.received[:, int(attribute)]

    @staticmethod
    def of_anchors(known: Bool[Tensor, "N"]) -> "Erasures":
        """Builds the erasures of atomic packaging: an anchor is there with all attributes or with none."""
        return Erasures(known[:, None].expand(-1, len(Attribute)).clone())
