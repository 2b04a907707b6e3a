"""No concealment: what did not arrive is not drawn."""

from dataclasses import dataclass

import torch

from splatwire.conceal.base import Concealed, register_concealer
from splatwire.conceal.context import AnchorContext, ElementContext
from splatwire.conceal.fill import prior_anchors
from splatwire.model import RenderHints


@register_concealer("drop")
@dataclass(frozen=True)
class Drop:
    """Leaves out every anchor of which an attribute is missing; invents nothing."""

    @property
    def name(self) -> str:
        """`drop`."""
        return "drop"

    def __call__(self, context: AnchorContext) -> Concealed:
        """See `Concealer`. Gaps hold the prior's mean, so that whoever ignores `left_out` meets no zero size."""
        return Concealed.drawn(prior_anchors(context), self.hints(context.elements))

    def hints(self, elements: ElementContext) -> RenderHints:
        """See `ElementConcealer`."""
        return RenderHints(torch.ones_like(elements.positions[:, 0]), ~elements.known)
