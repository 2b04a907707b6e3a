"""What a receiver of HAC++'s own layout does that knows of no loss: missing values are zero, everything is drawn."""

from dataclasses import dataclass

from splatwire.conceal.base import Concealed
from splatwire.conceal.registry import register_concealer
from splatwire.model import Partial
from splatwire.scene import Anchors


@register_concealer("zero", needs=[Anchors], listed=False)
@dataclass(frozen=True)
class Zero:
    """Draws every anchor with whatever is there; a concealer for comparison only.

    A decoder leaves zeros where it could read nothing, and the channels of the feature groups that it could read: this
    is the scene as it stands. An anchor whose mask is missing has no offset, so that nothing of it is drawn: with
    atomic packaging this is `drop`, which is why nobody is offered it.
    """

    @property
    def name(self) -> str:
        """`zero`."""
        return "zero"

    def __call__(self, context: Partial) -> Concealed:
        """See `Concealer`."""
        return Concealed.filled(context.elements)
