"""What the side information predicts about an anchor before any packet has arrived."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.reprs import summary_repr
from splatwire.scene import Anchors, Attribute, Erasures
from splatwire.scene.anchors import mean_log_size


@dataclass(frozen=True, eq=False)
class AttributePrior:
    """Predicted Gaussian and quantisation step of one attribute of N anchors.

    Attributes:
        mean: Predicted value per channel.
        scale: Predicted standard deviation per channel, positive.
        step: Quantisation step, one per anchor.
    """

    mean: Float[Tensor, "N D"]
    scale: Float[Tensor, "N D"]
    step: Float[Tensor, "N 1"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Prior:
    """The hash-grid prior of N anchors (HAC++, equation of `mu(x)`).

    Attributes:
        feature: Prior of the F feature channels.
        scaling: Prior of the 6 scalings.
        offset: Prior of the offsets, flattened offset-major to 3 K channels.
        context: Interpolated hash-grid feature.
    """

    feature: AttributePrior
    scaling: AttributePrior
    offset: AttributePrior
    context: Float[Tensor, "N H"]

    __repr__ = summary_repr

    @property
    def num_elements(self) -> int:
        """Anchors, N."""
        return len(self.context)

    def expected_log_sizes(self) -> Float[Tensor, "N"]:
        """Mean logarithm of the three sizes of an anchor's Gaussians, as predicted."""
        return mean_log_size(self.scaling.mean)

    def filled(self, elements: Anchors, erasures: Erasures) -> Anchors:
        """The anchors with every gap filled by the prior's mean; where the mask is missing, every offset exists."""
        missing = ~erasures.received

        def choose(attribute: Attribute, filled: Tensor, decoded: Tensor) -> Tensor:
            return torch.where(missing[:, int(attribute)].view(-1, *[1] * (decoded.dim() - 1)), filled, decoded)

        scalings = plausible_scalings(elements, erasures, self.scaling.mean)
        return replace(
            elements,
            features=choose(Attribute.FEATURE, self.feature.mean, elements.features),
            scalings=choose(Attribute.SCALING, scalings, elements.scalings),
            offsets=choose(Attribute.OFFSET, self.offset.mean.view(elements.offsets.shape), elements.offsets),
            mask=elements.mask | missing[:, int(Attribute.MASK), None],
        )


def plausible_scalings(anchors: Anchors, erasures: Erasures, scalings: Float[Tensor, "M 6"]) -> Float[Tensor, "M 6"]:
    """Raises estimated sizes to the smallest received size per channel: an estimate may fall below zero.

    Where nothing was received the floor is zero.

    Args:
        anchors: What arrived.
        erasures: What of it was received.
        scalings: The estimates.
    """
    received = anchors.scalings[erasures.column(Attribute.SCALING)]
    floor = received.amin(dim=0) if len(received) else torch.zeros(6, dtype=scalings.dtype)
    return torch.maximum(scalings, floor)
