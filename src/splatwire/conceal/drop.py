"""No concealment: what did not arrive is not drawn."""

from dataclasses import dataclass

import numpy as np

from splatwire.conceal.base import Concealed
from splatwire.conceal.registry import register_concealer
from splatwire.model import Partial


@register_concealer("drop")
@dataclass(frozen=True)
class Drop:
    """Leaves out every element of which an attribute is missing; invents nothing."""

    @property
    def name(self) -> str:
        """`drop`."""
        return "drop"

    def __call__(self, partial: Partial) -> Concealed:
        """See `Concealer`."""
        return Concealed(np.ones_like(partial.places[:, 0]), ~partial.known)
