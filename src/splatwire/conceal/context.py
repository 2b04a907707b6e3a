"""All that a concealer may see."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from splatwire.model import PartialScene, Prior
from splatwire.scene import AnchorLayout, Anchors, Erasures


@dataclass(frozen=True, eq=False)
class AnchorContext:
    """What arrived, where the gaps are and what the hash grid predicts; no model, no packets.

    Attributes:
        anchors: All anchors; attributes that were not received are zero (mask False), positions are always known.
        erasures: What was received.
        prior: The hash-grid prior of every anchor.
        layout: Sizes of an anchor.
        concealment: What the sender left for concealers in the side information, content by name.
    """

    anchors: Anchors
    erasures: Erasures
    prior: Prior
    layout: AnchorLayout
    concealment: Mapping[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = {self.anchors.num_anchors, len(self.erasures.received), len(self.prior.context)}
        if len(rows) != 1 or not self.anchors.matches(self.layout):
            raise ValueError(f"anchors, erasures, prior and layout do not fit: {sorted(rows)} rows, {self.layout}")

    def to_cpu(self) -> "AnchorContext":
        """Returns the same context in main memory, where neighbour search and kernels work."""
        prior = self.prior
        moved = {
            name: replace(part, mean=part.mean.cpu(), scale=part.scale.cpu(), step=part.step.cpu())
            for name, part in (("feature", prior.feature), ("scaling", prior.scaling), ("offset", prior.offset))
        }
        return replace(
            self,
            anchors=self.anchors.to("cpu"),
            erasures=Erasures(self.erasures.received.cpu()),
            prior=replace(prior, context=prior.context.cpu(), **moved),
        )


def context_of(partial: PartialScene) -> AnchorContext:
    """Takes from a partial scene what a concealer may see."""
    layout = partial.scene.coding.config.layout
    return AnchorContext(partial.scene.anchors, partial.erasures, partial.prior, layout, partial.concealment)
