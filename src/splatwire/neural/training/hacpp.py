"""The HAC++ context model in training."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.model.prior_field import PriorOutputs, split_prior_outputs
from splatwire.neural.model.tensors import run_network
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import (
    AnchorCache,
    MaskedAttributes,
    SampleBits,
    straight_through_masks,
)
from splatwire.neural.training.grid import sign_bits
from splatwire.neural.training.initial import grid_bounds
from splatwire.neural.training.kernels import COMPILED, Kernels, Uniform, uniform_from_host
from splatwire.neural.training.rate import bits, gaussian_likelihood, mixture_likelihood
from splatwire.neural.training.schedule import Phase, phase_of
from splatwire.neural.training.state import TrainState
from splatwire.types import HacppConfig, Linear, Mlp
from splatwire.types.prior import MIN_SCALE

Steps = Sequence[Tensor | float]
"""Quantisation steps of features, scalings and offsets: each a number, or a column with a row per anchor."""


@dataclass(frozen=True, eq=False)
class AttributeBits:
    """Bits of every attribute value of some anchors.

    Attributes:
        features: Bits of each feature channel.
        scalings: Bits of each scaling.
        offsets: Bits of each offset coordinate. Masked-out offsets are included. Order: x, y, z of the first offset,
            then of the second, and so on.
    """

    features: Float[Tensor, "M F"]
    scalings: Float[Tensor, "M S"]
    offsets: Float[Tensor, "M O"]


class TrainableHacpp:
    """Trainer of the HAC++ context model, which predicts the distributions of an anchor's attributes from a hash grid.

    Args:
        config: The configuration.
        kernels: Implementations of the expensive operations of training.
        cache: Cache of positions and hash-grid corners.
    """

    def __init__(self, config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> None:
        self._config, self._kernels, self._cache = config, kernels, cache

    def before_iteration(self, state: TrainState) -> None:
        """Begins the context phase: sets the bounding box of the hash grid again, and initialises the networks.

        The training calls the method before every iteration. The method acts before the first iteration whose loss
        includes the bit rate (`Milestones.context_start` + 1), and does nothing before all others.
        """
        if state.iteration == self._config.milestones.context_start + 1:
            state.bounds_min, state.bounds_max = grid_bounds(self._cache.positions(state))
            initialise_prior(state, self._config)

    def steps_and_bits(self, state: TrainState, visible: Int64[Tensor, "M"]) -> tuple[Steps | None, SampleBits | None]:
        """Determines the quantisation steps of the visible anchors, and estimates the bits of a sample of all anchors.

        Args:
            state: State of the training.
            visible: Indices of the visible anchors.

        Returns:
            Two values. The first is the quantisation steps; None in the first phase of the training. The second is the
            estimated bits of the sample; None while the loss excludes the bit rate.
        """
        config, phase = self._config, phase_of(self._config.milestones, state.iteration)
        if phase is Phase.PLAIN:
            return None, None
        if phase is Phase.NOISE:
            return config.hacpp.base_steps, None
        random, share = self._kernels.random, config.weights.sample_share
        sample = random.sample(state.num_anchors, share, state.generator, state.device)
        features = grid_features(state, self._cache, torch.cat([visible, sample]), self._kernels)
        logits = run_network(step_network(state.networks.context_prior), features[: len(visible)])
        masks = straight_through_masks(state, config, sample)
        estimated_bits = estimate_sample_bits(
            state, config, features[len(visible) :], sample, masks, self._kernels.random.uniform
        )
        return adaptive_steps(logits, config.hacpp).split(1, dim=1), estimated_bits

    def simulate_quantisation(
        self, state: TrainState, visible: Int64[Tensor, "M"]
    ) -> tuple[MaskedAttributes, SampleBits | None]:
        """Prepares the visible anchors for rendering, and estimates the bits of a random sample of all anchors.

        Args:
            state: State of the training.
            visible: Indices of the visible anchors.

        Returns:
            Attributes of the visible anchors with noise in place of rounding; their offset masks; and the estimated
            bits of the sample. While the loss excludes the bit rate, None replaces the bits.
        """
        steps, estimated_bits = self.steps_and_bits(state, visible)
        visible_attributes = (
            state.attributes(visible)
            if steps is None
            else noisy_attributes(state, visible, steps, self._kernels.random.uniform)
        )
        return (visible_attributes, straight_through_masks(state, self._config, visible)[0]), estimated_bits

    def rate_loss(self, state: TrainState, estimated_bits: SampleBits) -> Float[Tensor, ""]:
        """Returns the rate term of the loss: lambda times the mean bits per attribute value.

        Args:
            state: State of the training.
            estimated_bits: Estimated bits of a sample of anchors.
        """
        return state.current_lambda(self._config.weights) * self.bits_per_value(state, estimated_bits)

    def expected_scalings(self, state: TrainState, index: Int64[Tensor, "M"]) -> Float[Tensor, "M 6"]:
        """Predicts the scalings of anchors from their positions alone, as a receiver must for lost anchors.

        Args:
            state: State of the training.
            index: Indices of the M anchors in the training state.

        Returns:
            The scalings, world units.
        """
        prior, start = state.networks.context_prior, 3 * self._config.model.layout.feature_dim
        columns = slice(start, start + 6)
        means = Mlp(
            prior.hidden, Linear(prior.output.weight[columns], prior.output.bias[columns]), prior.negative_slope
        )
        return run_network(means, grid_features(state, self._cache, index, self._kernels))

    def bits_per_value(self, state: TrainState, estimated_bits: SampleBits) -> Float[Tensor, ""]:
        """Estimates the mean number of bits per attribute value of a scene, including the bits of the hash grid."""
        # The bits of the attributes are estimated from a sample of anchors. The bits of the hash grid's signs
        # are added, divided by the number of attribute values of all anchors.
        layout = self._config.model.layout
        per_anchor = layout.feature_dim + 6 + 3 * layout.num_offsets
        grid = sign_bits(state.parameters["grid.volume"], state.parameters["grid.planes"])
        return estimated_bits.bits / max(estimated_bits.num_anchors * per_anchor, 1) + grid / (
            state.num_anchors * per_anchor
        )


def step_network(prior: Mlp) -> Mlp:
    """Returns the part of the prior network that predicts quantisation steps; it shares the network's weights."""
    return Mlp(prior.hidden, Linear(prior.output.weight[-3:], prior.output.bias[-3:]), prior.negative_slope)


def adaptive_steps(step_logits: Float[Tensor, "N 3"], config: HacppConfig) -> Float[Tensor, "N 3"]:
    """Returns the quantisation steps of features, scalings and offsets, `base * (1 + tanh(logit))` (HAC++)."""
    return step_logits.new_tensor(config.base_steps) * (1 + torch.tanh(step_logits))


def grid_features(
    state: TrainState, cache: AnchorCache, index: Int64[Tensor, "M"], kernels: Kernels = COMPILED
) -> Float[Tensor, "M H"]:
    """Returns the hash-grid features of the anchors `index`; differentiable in the grid's tables."""
    volume, planes = state.parameters["grid.volume"], state.parameters["grid.planes"]
    return kernels.interpolate_signs(volume, planes, cache.corners(state), index)


def noisy_attributes(
    state: TrainState, index: Int64[Tensor, "M"], steps: Steps, uniform: Uniform = uniform_from_host
) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M S"], Float[Tensor, "M O"]]:
    """Returns the attributes of the given anchors, with uniform noise in place of rounding.

    Args:
        state: State of the training.
        index: Indices of the M anchors in the training state.
        steps: Quantisation steps of features, scalings and offsets.
        uniform: Function that draws uniform random numbers in [0, 1).

    Returns:
        Features, scalings and flattened offsets, one row per anchor.
    """
    feature, scaling, offset = (
        values + (uniform(values.shape, state.generator, values.device) - 0.5) * step
        for values, step in zip(state.attributes(index), steps, strict=True)
    )
    return feature, scaling, offset


def estimate_sample_bits(
    state: TrainState,
    config: TrainConfig,
    features: Float[Tensor, "M H"],
    index: Int64[Tensor, "M"],
    mask: tuple[Float[Tensor, "M K"], Float[Tensor, "M"]],
    uniform: Uniform = uniform_from_host,
) -> SampleBits:
    """Estimates the bits of a sample of anchors.

    Args:
        state: State of the training.
        config: The configuration.
        features: Hash-grid features of the sample.
        index: Indices of the sampled anchors.
        mask: Masks of the sample's offsets and of its anchors, 0 or 1. Gradients pass through the binarisation
            unchanged (straight-through estimator).
        uniform: Function that draws uniform random numbers, for the noise that replaces rounding.
    """
    layout = config.model.layout
    outputs = split_prior_outputs(run_network(state.networks.context_prior, features), config.hacpp)
    steps = adaptive_steps(outputs.step_logits, config.hacpp)
    values = noisy_attributes(state, index, steps.split(1, dim=1), uniform)
    bits = attribute_bits(outputs, state.networks.channel, layout.feature_groups, steps, values)
    offset_mask, anchor_mask = mask
    offset_bits = (bits.offsets.view(-1, layout.num_offsets, 3).sum(dim=2) * offset_mask).sum(dim=1)
    total = ((bits.features.sum(dim=1) + bits.scalings.sum(dim=1) + offset_bits) * anchor_mask).sum()
    return SampleBits(total, len(index))


def attribute_bits(
    outputs: PriorOutputs,
    channels: tuple[Mlp, ...],
    groups: tuple[int, ...],
    steps: Float[Tensor, "M 3"],
    values: tuple[Float[Tensor, "M F"], Float[Tensor, "M S"], Float[Tensor, "M O"]],
) -> AttributeBits:
    """Estimates the bits of every attribute value of some anchors (as in HAC++).

    Args:
        outputs: Outputs of the prior network for these anchors.
        channels: Channel networks, one per group.
        groups: Sizes of the groups of feature channels.
        steps: Quantisation steps of features, scalings and offsets.
        values: Features, scalings and offsets, rounded or with noise in place of rounding.
    """
    feature_step, scaling_step, offset_step = steps.split(1, dim=1)
    feature, scaling, offset = values
    first = gaussian_likelihood(feature, outputs.feature_mean, outputs.feature_scale.clamp(min=MIN_SCALE), feature_step)
    second, weight = _channel_likelihood(channels, groups, feature, outputs, feature_step)
    return AttributeBits(
        bits(mixture_likelihood(first, second, outputs.feature_weight - weight)),
        bits(gaussian_likelihood(
            scaling, outputs.scaling_mean, outputs.scaling_scale.clamp(min=MIN_SCALE), scaling_step)),
        bits(gaussian_likelihood(offset, outputs.offset_mean, outputs.offset_scale.clamp(min=MIN_SCALE), offset_step)),
    )  # fmt: skip


def _channel_likelihood(
    channels: tuple[Mlp, ...],
    groups: tuple[int, ...],
    feature: Float[Tensor, "M F"],
    outputs: PriorOutputs,
    step: Float[Tensor, "M 1"],
) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M F"]]:
    """Returns the probability that the channel networks predict for each quantised feature.

    Args:
        channels: Channel networks, one per group.
        groups: Sizes of the groups of feature channels.
        feature: Features, rounded or with noise in place of rounding.
        outputs: Outputs of the prior network.
        step: Quantisation step of the features.

    Returns:
        Probability of each feature according to the channel networks; and logit of the weight of this probability. The
        final probability is a mixture of this probability and the probability that the prior network predicts.
    """
    # Each network predicts a group of feature channels from the previous groups and the output of the prior
    # network.
    shared = torch.cat([outputs.feature_mean, outputs.feature_scale, outputs.feature_weight], dim=1)
    parts, before = [], 0
    for mlp, size in zip(channels, groups, strict=True):
        parts.append(run_network(mlp, torch.cat([feature[:, :before], shared], dim=1)).chunk(3, dim=1))
        before += size
    mean, scale, weight = (torch.cat(columns, dim=1) for columns in zip(*parts, strict=True))
    return gaussian_likelihood(feature, mean, scale.clamp(min=MIN_SCALE), step), weight


@torch.no_grad()
def initialise_prior(state: TrainState, config: TrainConfig) -> None:
    """Initialises the context networks so that they predict the present mean and deviation of each attribute.

    Args:
        state: State of the training; the networks are changed in place.
        config: The configuration.
    """
    # From random outputs, training would improve the predictions only slowly.
    alive = state.masks(config.mask_threshold).any(dim=1)
    if int(alive.sum()) < 2:
        return
    columns = []
    for values, base in zip(state.attributes(alive), config.hacpp.base_steps, strict=True):
        columns.append((values.mean(dim=0), values.std(dim=0).clamp(min=0.5 * base)))
    # With random outputs, the standard deviations of half of the channels would be negative.
    weight, bias = state.networks.context_prior.output.weight, state.networks.context_prior.output.bias
    (f_mean, f_spread), (s_mean, s_spread), (o_mean, o_spread) = columns
    zeros = torch.zeros_like(f_mean)
    bias[:-3] = torch.cat([f_mean, f_spread, zeros, s_mean, s_spread, o_mean, o_spread])
    bias[-3:] = 0
    weight[:-3] *= torch.cat([f_spread, f_spread, zeros + 1, s_spread, s_spread, o_spread, o_spread])[:, None]
    start = 0
    for mlp, size in zip(state.networks.channel, config.model.layout.feature_groups, strict=True):
        part = slice(start, start + size)
        mlp.output.weight.mul_(torch.cat([f_spread[part], f_spread[part], zeros[part] + 1])[:, None])
        mlp.output.bias.copy_(torch.cat([f_mean[part], f_spread[part], zeros[part]]))
        start += size
