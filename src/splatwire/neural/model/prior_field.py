"""Outputs of HAC++'s prior network, which predicts the distributions of anchor attributes."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from splatwire.reprs import summary_repr
from splatwire.types.anchor_config import HacppConfig


@dataclass(frozen=True, eq=False)
class PriorOutputs:
    """Outputs of the prior network: distributions of an anchor's attributes, predicted from the anchor's position.

    There is one row per anchor.

    Attributes:
        feature_mean: Mean of each feature channel.
        feature_scale: Standard deviation of each feature channel, unclamped.
        feature_weight: Logit of the weight of the distribution with `feature_mean` and `feature_scale`, per channel. A
            feature is predicted by a mixture of two distributions. The other distribution and the logit of its weight
            are outputs of the channel networks.
        scaling_mean: Mean of each scaling.
        scaling_scale: Standard deviation of each scaling, unclamped.
        offset_mean: Mean of each offset coordinate, in the order x, y, z of the first offset, then of the second, and
            so on.
        offset_scale: Standard deviation of each offset coordinate, unclamped.
        step_logits: Logits of the quantisation steps of feature, scaling and offset.
    """

    feature_mean: Float[Tensor, "N F"]
    feature_scale: Float[Tensor, "N F"]
    feature_weight: Float[Tensor, "N F"]
    scaling_mean: Float[Tensor, "N 6"]
    scaling_scale: Float[Tensor, "N 6"]
    offset_mean: Float[Tensor, "N K3"]
    offset_scale: Float[Tensor, "N K3"]
    step_logits: Float[Tensor, "N 3"]

    __repr__ = summary_repr


def split_prior_outputs(outputs: Float[Tensor, "N P"], config: HacppConfig) -> PriorOutputs:
    """Splits the output columns of the prior network into means, standard deviations, weights and step logits.

    Args:
        outputs: Output of the network `HacppContextModel.prior`, with `HacppConfig.prior_dim` columns.
        config: Shapes of anchors and networks.
    """
    features, offsets = config.layout.feature_dim, 3 * config.layout.num_offsets
    return PriorOutputs(*outputs.split([features] * 3 + [6] * 2 + [offsets] * 2 + [3], dim=1))


def typical_spread(scale: Float[Tensor, "N D"], step: float) -> Float[Tensor, "D"]:
    """Returns the typical standard deviation of each channel of an attribute, including the rounding error.

    The result combines the median of the predicted standard deviations over the anchors with the standard deviation of
    the rounding error.

    Args:
        scale: Predicted standard deviations of the channels of some anchors.
        step: Base quantisation step of the attribute.
    """
    # Combines the median of the predicted standard deviations with the rounding error, whose variance is `step**2 /
    # 12`.
    typical = scale.clamp(min=step * 1e-3).median(dim=0).values
    return (typical**2 + step**2 / 12).sqrt()
