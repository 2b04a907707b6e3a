"""No concealment: lost elements are not drawn."""

from dataclasses import dataclass

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.concealment.base import Concealed
from splatwire.concealment.registry import register_concealer
from splatwire.types import ReceivedScene


@register_concealer("drop")
@dataclass(frozen=True)
class Drop(CheckedFields):
    """Hides every element with a missing attribute; estimates no values."""

    @property
    def name(self) -> str:
        """Name of this concealer in the registry, `drop`."""
        return "drop"

    def __call__(self, received: ReceivedScene) -> Concealed:
        """Returns hints that hide every element with at least one lost attribute."""
        return Concealed(np.ones_like(received.positions[:, 0]), ~received.fully_received)
