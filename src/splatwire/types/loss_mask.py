"""Masks of received attributes, per element (Gaussian, anchor or track) and attribute."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool

from splatwire.arguments import CheckedFields, array_of
from splatwire.errors import InvalidValueError, shown
from splatwire.reprs import summary_repr
from splatwire.types.attributes import Attribute


@dataclass(frozen=True, eq=False)
class LossMask(CheckedFields):
    """Loss mask of N elements: which of the four coded attributes of each element were received.

    The columns are the attributes of an anchor. Gaussians and tracks are received as a whole: their four columns are
    equal (`of_elements`).

    Attributes:
        received: True if the attribute of the element was received, bool (N, 4); columns in the order of `Attribute`.
    """

    received: Bool[Any, "N 4"]

    __repr__ = summary_repr

    @property
    def fully_received(self) -> Bool[Any, "N"]:
        """Mask of elements with every attribute received."""
        return self.received.all(1)

    @property
    def known(self) -> Bool[Any, "N"]:
        """Deprecated name of `fully_received`."""
        warnings.warn("LossMask.known is deprecated, use fully_received", DeprecationWarning, stacklevel=2)
        return self.fully_received

    @property
    def num_lost(self) -> int:
        """Number of elements with at least one missing attribute."""
        return int((~self.fully_received).sum())

    def column(self, attribute: Attribute) -> Bool[Any, "N"]:
        """Mask of the elements for which a given attribute was received.

        Raises:
            InvalidValueError: If there is no such attribute.
        """
        if (
            not isinstance(attribute, (int, np.integer))
            or isinstance(attribute, bool)
            or attribute not in tuple(Attribute)
        ):
            names = ", ".join(each.name for each in Attribute)
            raise InvalidValueError(f"attribute: expected an Attribute ({names}), not {shown(attribute)}")
        return self.received[:, int(attribute)]

    @staticmethod
    def of_elements(fully_received: Bool[Any, "N"]) -> "LossMask":
        """Builds the mask of elements whose attributes were either all received or all lost.

        Args:
            fully_received: Mask of received elements (Gaussians, anchors or tracks).

        Raises:
            InvalidValueError: If `fully_received` is not a one-dimensional array of booleans.
        """
        fully_received = array_of(fully_received, "fully_received", ("N",), "b")
        return LossMask(np.repeat(fully_received[:, None], len(Attribute), axis=1))

    @staticmethod
    def of_anchors(fully_received: Bool[Any, "N"]) -> "LossMask":
        """Deprecated name of `of_elements`."""
        warnings.warn("LossMask.of_anchors is deprecated, use of_elements", DeprecationWarning, stacklevel=2)
        return LossMask.of_elements(fully_received)
