"""No concealment: what did not arrive is not drawn."""

from dataclasses import dataclass

from splatwire.conceal.base import Concealed, register_concealer
from splatwire.conceal.context import AnchorContext
from splatwire.conceal.fill import prior_anchors


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
        proposal = Concealed.filled(prior_anchors(context))
        return Concealed(proposal.anchors, proposal.size_gain, ~context.erasures.known)
