"""What the hash grid and its network say about an anchor from its position alone (HAC++)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.anchor_scene import ContextModel
from splatwire.model.config import ModelConfig
from splatwire.model.hash_grid import interpolate_hash_grid
from splatwire.model.prior import MIN_SCALE, AttributePrior, Prior
from splatwire.reprs import summary_repr

_CHUNK = 32768


@dataclass(frozen=True, eq=False)
class PriorOutputs:
    """The outputs of the prior network, named, before any clamp or activation.

    Attributes:
        feature_mean: Mean of each feature channel.
        feature_scale: Standard deviation of each feature channel, unclamped.
        feature_weight: Weight logit of this Gaussian in the mixture of the feature channel.
        scaling_mean: Mean of each scaling.
        scaling_scale: Standard deviation of each scaling, unclamped.
        offset_mean: Mean of each offset coordinate, offset-major.
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


def split_prior_outputs(outputs: Float[Tensor, "N P"], config: ModelConfig) -> PriorOutputs:
    """Names the columns of the prior network's output; the tensors are views.

    Args:
        outputs: Output of `ContextModel.prior`, `ModelConfig.prior_dim` columns.
        config: Shapes.
    """
    features, offsets = config.layout.feature_dim, 3 * config.layout.num_offsets
    return PriorOutputs(*outputs.split([features] * 3 + [6] * 2 + [offsets] * 2 + [3], dim=1))


def prior_of(outputs: PriorOutputs, context: Float[Tensor, "N H"], config: ModelConfig) -> Prior:
    """Turns network outputs into Gaussians and steps: `step = base * (1 + tanh(logit))`; differentiable.

    Args:
        outputs: Outputs of the prior network.
        context: The interpolated hash-grid feature that they come from.
        config: Shapes and base steps.
    """
    base = outputs.step_logits.new_tensor(config.base_steps)
    steps = base * (1 + torch.tanh(outputs.step_logits))
    return Prior(
        feature=AttributePrior(outputs.feature_mean, outputs.feature_scale.clamp(min=MIN_SCALE), steps[:, 0:1]),
        scaling=AttributePrior(outputs.scaling_mean, outputs.scaling_scale.clamp(min=MIN_SCALE), steps[:, 1:2]),
        offset=AttributePrior(outputs.offset_mean, outputs.offset_scale.clamp(min=MIN_SCALE), steps[:, 2:3]),
        context=context,
    )


@torch.no_grad()
def evaluate_prior(context: ContextModel, positions: Float[Tensor, "N 3"], config: ModelConfig) -> Prior:
    """Evaluates the prior of anchors at `positions`, in chunks.

    Args:
        context: Hash grid and prior network.
        positions: World coordinates.
        config: Shapes and base steps.
    """
    feature = interpolate_hash_grid(context.grid, positions, config.grid)
    outputs = positions.new_empty(len(positions), config.prior_dim)
    for start in range(0, len(positions), _CHUNK):
        outputs[start : start + _CHUNK] = context.prior(feature[start : start + _CHUNK])
    return prior_of(split_prior_outputs(outputs, config), feature, config)


def typical_spread(scale: Float[Tensor, "N D"], step: float) -> Float[Tensor, "D"]:
    """Typical spread of each channel: its median predicted scale and the rounding of its symbols together.

    Args:
        scale: Predicted scales of some anchors.
        step: Base step of the attribute.
    """
    typical = scale.clamp(min=step * 1e-3).median(dim=0).values
    return (typical**2 + step**2 / 12).sqrt()
