"""What the feature groups decoded so far say about the next group (HAC++, channel context)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.anchor_scene import ContextModel
from splatwire.model.prior import MIN_SCALE
from splatwire.model.prior_field import PriorOutputs
from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class ChannelParameters:
    """The second Gaussian of the mixture of each channel of one feature group.

    Attributes:
        mean: Mean of each channel.
        scale: Standard deviation, positive.
        weight: Weight logit of this Gaussian; the mixture weights are the softmax of the prior's logit and this one.
    """

    mean: Float[Tensor, "N C"]
    scale: Float[Tensor, "N C"]
    weight: Float[Tensor, "N C"]

    __repr__ = summary_repr


def channel_parameters(
    context: ContextModel, group: int, decoded_features: Float[Tensor, "N D"], outputs: PriorOutputs
) -> ChannelParameters:
    """Predicts the channels of feature group `group`; differentiable.

    Args:
        context: The networks.
        group: Index of the group.
        decoded_features: The channels of all groups before it (none for group 0).
        outputs: Outputs of the prior network for the same anchors.

    Raises:
        ValueError: If `decoded_features` does not have the channels of the groups before.
    """
    network = context.channel[group]
    inputs = [decoded_features, outputs.feature_mean, outputs.feature_scale, outputs.feature_weight]
    expected = network.hidden.weight.shape[1] - 3 * outputs.feature_mean.shape[1]
    if decoded_features.shape[1] != expected:
        raise ValueError(f"group {group} follows {expected} channels, not {decoded_features.shape[1]}")
    mean, scale, weight = network(torch.cat(inputs, dim=1)).chunk(3, dim=1)
    return ChannelParameters(mean, scale.clamp(min=MIN_SCALE), weight)
