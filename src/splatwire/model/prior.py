"""What the side information predicts about an anchor before any packet has arrived."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.ops.arrays import to_numpy, where
from splatwire.reprs import summary_repr
from splatwire.scene import Anchors, Attribute, Erasures
from splatwire.scene.anchors import mean_log_size

MIN_SCALE = 1e-9
"""Floor of every predicted standard deviation."""


@dataclass(frozen=True, eq=False)
class AttributePrior:
    """Predicted Gaussian and quantisation step of one attribute of N anchors.

    Attributes:
        mean: Predicted value per channel.
        scale: Predicted standard deviation per channel, positive.
        step: Quantisation step, one per anchor.
    """

    mean: Float[Any, "N D"]
    scale: Float[Any, "N D"]
    step: Float[Any, "N 1"]

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
    context: Float[Any, "N H"]

    __repr__ = summary_repr

    @property
    def num_elements(self) -> int:
        """Anchors, N."""
        return len(self.context)

    def expected_log_sizes(self) -> Float[Any, "N"]:
        """Mean logarithm of the three sizes of an anchor's Gaussians, as predicted."""
        return mean_log_size(self.scaling.mean)

    def filled(self, elements: Anchors, erasures: Erasures) -> Anchors:
        """The anchors with every gap filled by the prior's mean; where the mask is missing, every offset exists."""
        missing = ~erasures.received

        def choose(attribute: Attribute, filled: Any, decoded: Any) -> Any:
            return where(missing[:, int(attribute)].reshape(-1, *[1] * (decoded.ndim - 1)), filled, decoded)

        scalings = plausible_scalings(elements, erasures, self.scaling.mean)
        return replace(
            elements,
            features=choose(Attribute.FEATURE, self.feature.mean, elements.features),
            scalings=choose(Attribute.SCALING, scalings, elements.scalings),
            offsets=choose(Attribute.OFFSET, self.offset.mean.reshape(elements.offsets.shape), elements.offsets),
            mask=elements.mask | missing[:, int(Attribute.MASK), None],
        )


def plausible_scalings(anchors: Anchors, erasures: Erasures, scalings: Float[Any, "M 6"]) -> Float[Any, "M 6"]:
    """Raises estimated sizes to the smallest received size per channel: an estimate may fall below zero.

    Where nothing was received the floor is zero.

    Args:
        anchors: What arrived.
        erasures: What of it was received.
        scalings: The estimates.
    """
    received = anchors.scalings[erasures.column(Attribute.SCALING)]
    if not len(received):
        return where(scalings > 0, scalings, 0)
    if isinstance(scalings, np.ndarray):
        return np.maximum(scalings, to_numpy(received).min(axis=0))
    return scalings.maximum(received.amin(0))
