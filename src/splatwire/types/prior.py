"""Predicted distributions of anchor attributes, available before any packet."""

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.arguments import CheckedFields, checked
from splatwire.ops.arrays import to_numpy, where
from splatwire.reprs import summary_repr
from splatwire.types.anchors import Anchors, mean_log_size
from splatwire.types.attributes import Attribute
from splatwire.types.loss_mask import LossMask

MIN_SCALE = 1e-9
"""Lower bound of predicted standard deviations."""


@dataclass(frozen=True, eq=False)
class AttributePrior(CheckedFields):
    """Predicted normal distribution and quantisation step of one attribute of N anchors.

    Attributes:
        mean: Predicted mean of each of the D channels.
        scale: Predicted standard deviation of each channel, positive.
        step: Quantisation step, one per anchor.
    """

    mean: Float[Any, "N D"]
    scale: Float[Any, "N D"]
    step: Float[Any, "N 1"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Prior(CheckedFields):
    """Distributions of the attributes of N anchors, predicted from the side information alone, without any packet.

    HAC++ predicts them from its hash grid, the causal model from the positions of the anchors.

    Attributes:
        feature: Distributions of the F feature channels.
        scaling: Distributions of the 6 scalings.
        offset: Distributions of the 3 K coordinates of the K offsets.
        context_features: Interpolated hash-grid features (HAC++), or outputs of the network of positions (causal).
    """

    feature: AttributePrior
    scaling: AttributePrior
    offset: AttributePrior
    context_features: Float[Any, "N H"]

    __repr__ = summary_repr

    @property
    def num_elements(self) -> int:
        """Number of anchors, N, for which the prior network predicts attributes."""
        return len(self.context_features)

    @property
    def context(self) -> Float[Any, "N H"]:
        """Deprecated name of `context_features`."""
        warnings.warn("Prior.context is deprecated, use context_features", DeprecationWarning, stacklevel=2)
        return self.context_features

    def predicted_log_sizes(self) -> Float[Any, "N"]:
        """Returns the predicted log size of the Gaussians of each anchor, averaged over three axes.

        The unit is the natural logarithm of world units.
        """
        return mean_log_size(self.scaling.mean)

    @checked
    def filled(self, elements: Anchors, loss_mask: LossMask) -> Anchors:
        """Returns the anchors with every missing attribute replaced by its predicted mean."""
        missing = ~loss_mask.received

        def choose(attribute: Attribute, filled: Any, decoded: Any) -> Any:
            return where(missing[:, int(attribute)].reshape(-1, *[1] * (decoded.ndim - 1)), filled, decoded)

        scalings = plausible_scalings(elements, loss_mask, self.scaling.mean)
        return replace(
            elements,
            features=choose(Attribute.FEATURE, self.feature.mean, elements.features),
            scalings=choose(Attribute.SCALING, scalings, elements.scalings),
            offsets=choose(Attribute.OFFSET, self.offset.mean.reshape(elements.offsets.shape), elements.offsets),
            mask=elements.mask | missing[:, int(Attribute.MASK), None],
        )


def plausible_scalings(anchors: Anchors, loss_mask: LossMask, scalings: Float[Any, "M 6"]) -> Float[Any, "M 6"]:
    """Raises estimated scalings that are too small to a lower limit.

    Each of the six components has its own limit: the smallest received value of this component. If no scaling was
    received, the limits are 0.

    Args:
        anchors: All anchors.
        loss_mask: Mask of received attributes.
        scalings: Estimated scalings of M anchors.
    """
    received = anchors.scalings[loss_mask.column(Attribute.SCALING)]
    if not len(received):
        return where(scalings > 0, scalings, 0)
    if isinstance(scalings, np.ndarray):
        return np.maximum(scalings, to_numpy(received).min(axis=0))
    return scalings.maximum(received.amin(0))
