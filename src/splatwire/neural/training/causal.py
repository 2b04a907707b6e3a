"""Training of the causal context model, which predicts each attribute from the attributes coded before it."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.anchors.causal_prediction import CausalPrediction, position_inputs, predict_causal
from splatwire.neural.model.tensors import run_network
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache, MaskedAttributes, SampleBits, straight_through_masks
from splatwire.neural.training.initial import position_bounds
from splatwire.neural.training.kernels import Kernels, Uniform
from splatwire.neural.training.rate import bits
from splatwire.neural.training.schedule import Phase, phase_of
from splatwire.neural.training.state import CONTEXT_NEGATIVE_SLOPE, TrainState, expanded_scalings
from splatwire.types import Linear, Mlp
from splatwire.types.causal_coding import MASK_AND_SCALE, NUM_LOG_SCALINGS, CausalConfig

RATE_UNIT = 8e6
"""Bits per megabyte; lambda is the weight of a megabyte of the whole scene."""
POSITION_BITS = 16.0
"""Approximate bits of an anchor's position. Part of the rate, so that anchors that contribute little are removed."""
LOG_DEVIATION_RANGE = (-6.0, 13.0)
"""Limits of the binary logarithm of a predicted standard deviation in quantisation steps."""
MIN_INITIAL_DEVIATION = 0.5
"""Minimum of the initially predicted standard deviations, in quantisation steps."""


class TrainableCausal:
    """Trainer of the causal context model.

    This model predicts the distributions of an anchor's attributes from the anchor's position and from the attributes
    that were decoded earlier.

    Args:
        config: The configuration.
        kernels: Implementations of the expensive operations of training.
        cache: Cache of the anchors' positions.
    """

    def __init__(self, config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> None:
        self._config, self._random, self._cache = config, kernels.random, cache
        self._causal_config = config.causal
        self._key: Tensor | None = None
        self._inputs: Tensor | None = None

    def before_iteration(self, state: TrainState) -> None:
        """Begins the context phase: sets the range of positions again, and initialises the networks.

        The training calls the method before every iteration. The method acts before the first iteration whose loss
        includes the bit rate (`Milestones.context_start` + 1), and does nothing before all others.
        """
        if state.iteration == self._config.milestones.context_start + 1:
            state.bounds_min, state.bounds_max = position_bounds(state.voxels)
            self._key = None
            initialise_causal(state, self._config, self._position_inputs(state))

    def _position_inputs(self, state: TrainState) -> Float[Tensor, "N P"]:
        """Returns the positions of all anchors and their positional encoding, the input of the position network.

        The result is cached until anchors are added, removed or sorted.
        """
        if self._inputs is None or self._key is not state.voxels:
            self._key, self._inputs = state.voxels, position_inputs_of(state)
        return self._inputs

    def simulate_quantisation(
        self, state: TrainState, visible: Int64[Tensor, "M"]
    ) -> tuple[MaskedAttributes, SampleBits | None]:
        """Prepares the visible anchors for rendering, and estimates how many bits a random sample of all anchors takes.

        Args:
            state: State of the training.
            visible: Indices of the visible anchors.

        Returns:
            Attributes of the visible anchors with noise in place of rounding; their offset masks; and the estimated
            bits of the sample. While the loss excludes the bit rate, None replaces the bits.
        """
        config, phase = self._config, phase_of(self._config.milestones, state.iteration)
        masks = straight_through_masks(state, config, visible)[0]
        if phase is Phase.PLAIN:
            return (state.attributes(visible), masks.detach()), None
        steps = attribute_steps(state.parameters["log_steps"], self._causal_config)
        if phase is Phase.NOISE:
            steps = (steps[0].detach(), steps[1].detach(), steps[2].detach())
        feature, logs, offsets = noisy_causal_attributes(state, visible, steps, self._random.uniform)
        visible_attributes = feature, expanded_scalings(logs.exp()), offsets
        if phase is Phase.NOISE:  # masks are trained only once the loss includes the rate
            return (visible_attributes, masks.detach()), None
        share = config.weights.sample_share
        sample = self._random.sample(state.num_anchors, share, state.generator, state.device)
        return (visible_attributes, masks), self._rate(state, sample, steps)

    def expected_scalings(self, state: TrainState, index: Int64[Tensor, "M"]) -> Float[Tensor, "M 6"]:
        """Returns the scalings, world units, that a receiver predicts for lost anchors.

        The prediction depends only on the anchors' positions.

        Args:
            state: State of the training.
            index: Indices of the M anchors in the training state.
        """
        inputs, layout = self._position_inputs(state)[index], self._causal_config.layout
        networks, nothing = causal_networks(state.parameters, self._causal_config), inputs.new_zeros(len(inputs), 1)
        predicted = predict_causal(
            _functions(networks), self._causal_config, inputs, nothing.expand(-1, layout.feature_dim),
            nothing.expand(-1, NUM_LOG_SCALINGS), input_values=lambda name, mean, values: mean, join=torch.cat,
        )  # fmt: skip
        steps = attribute_steps(state.parameters["log_steps"], self._causal_config)[1]
        return expanded_scalings((predicted.log_scalings[0] * steps + state.parameters["zero_points"]).exp())

    def rate_loss(self, state: TrainState, estimated_bits: SampleBits) -> Float[Tensor, ""]:
        """Returns the rate term of the loss: lambda times the estimated size of the scene in megabytes."""
        scale_to_all = state.num_anchors / max(estimated_bits.num_anchors, 1)
        return state.current_lambda(self._config.weights) * estimated_bits.bits * scale_to_all / RATE_UNIT

    def _rate(self, state: TrainState, sample: Int64[Tensor, "M"], steps: tuple[Tensor, Tensor, Tensor]) -> SampleBits:
        masks = straight_through_masks(state, self._config, sample)
        values = noisy_causal_attributes(state, sample, steps, self._random.uniform)
        total = anchor_bits(state, self._causal_config, self._position_inputs(state)[sample], values, steps, masks)
        return SampleBits(total.sum(), len(sample))


def position_inputs_of(state: TrainState) -> Float[Tensor, "N P"]:
    """Computes the inputs of the position network for all anchors: positions and their positional encoding."""
    middle, spread = (state.bounds_max + state.bounds_min) / 2, (state.bounds_max - state.bounds_min) / 2
    return position_inputs((state.voxels - middle) / spread, torch.cat)


def attribute_steps(log_steps: Float[Tensor, "S"], config: CausalConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Returns the quantisation step of each attribute value of an anchor.

    An anchor has features, four logarithms (of one offset scale and three sizes), and offsets of the Gaussians'
    centres.

    Args:
        log_steps: Natural logarithms of the trained quantisation steps: one for each feature group, one for the offset
            scale, one for all three sizes, and one for the offsets.
        config: Shapes of anchors and networks.

    Returns:
        Steps of the F feature channels, (F); of the four logarithms, (4); and of the offsets, a single number.
    """
    steps, groups = log_steps.exp(), config.layout.feature_groups
    repeats = torch.tensor(groups, device=log_steps.device)
    feature = steps[: len(groups)].repeat_interleave(repeats)
    scale, size, offset = steps[len(groups) :]
    return feature, torch.stack([scale, size, size, size]), offset


def noisy_causal_attributes(
    state: TrainState, index: Int64[Tensor, "M"], steps: tuple[Tensor, ...], uniform: Uniform
) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M 4"], Float[Tensor, "M O"]]:
    """Returns features, logarithms of scale and sizes, and offsets of anchors, with noise in place of rounding.

    The noise is uniform and as wide as the quantisation step.

    Args:
        state: State of the training.
        index: Indices of the M anchors in the training state.
        steps: Quantisation steps (`attribute_steps`).
        uniform: Draws the random numbers.

    Returns:
        Features; logarithms of the offset scale and of three sizes; and flattened offsets. Each has one row per anchor.
    """
    # The noise is uniform and as wide as the quantisation steps. Offsets are multiplied by the anchor's scale, so
    # they are first corrected for the noise of the scale. An encoder does the same with the rounded scale.

    def noisy(values: Tensor, step: Tensor) -> Tensor:
        return values + (uniform(values.shape, state.generator, values.device) - 0.5) * step

    parameters = state.parameters
    before = parameters["log_scalings"][index]
    feature, logs = noisy(parameters["features"][index], steps[0]), noisy(before, steps[1])
    offsets = parameters["offsets"][index].flatten(1) * (before[:, :1] - logs[:, :1]).exp()
    return feature, logs, noisy(offsets, steps[2])


def causal_networks(parameters: dict[str, Tensor], config: CausalConfig) -> dict[str, Mlp]:
    """Builds the networks of the causal model from trained parameters; returns them by name."""

    def layer(name: str) -> Linear:
        return Linear(parameters[f"causal.{name}.weight"], parameters[f"causal.{name}.bias"])

    return {
        name: Mlp(layer(f"{name}.hidden"), layer(f"{name}.output"), CONTEXT_NEGATIVE_SLOPE) for name in config.shapes()
    }


def _functions(networks: dict[str, Mlp]) -> dict[str, Callable[[Tensor], Tensor]]:
    """Returns the networks of the causal model as functions, by name."""
    return {name: partial(run_network, network) for name, network in networks.items()}


def anchor_bits(
    state: TrainState,
    config: CausalConfig,
    position_inputs: Float[Tensor, "M P"],
    values: tuple[Tensor, Tensor, Tensor],
    steps: tuple[Tensor, Tensor, Tensor],
    masks: tuple[Tensor, Tensor],
) -> Float[Tensor, "M"]:
    """Estimates the total bits of anchors: attributes, masks and positions.

    Args:
        state: State of the training.
        config: Shapes of anchors and networks.
        position_inputs: Positions of the anchors and their positional encoding, as inputs of the position network.
        values: Features, logarithms of scale and sizes, and offsets, with noise (`noisy_causal_attributes`).
        steps: Quantisation steps of these values (`attribute_steps`).
        masks: Masks of offsets and of anchors, 0 or 1. Gradients pass through the masks to their logits.
    """
    logs = values[1] - state.parameters["zero_points"].detach()
    values_in_steps = [value / step for value, step in zip((values[0], logs, values[2]), steps, strict=True)]
    offset_mask, anchor_mask = masks
    anchor_value_bits, offsets = anchor_and_offset_bits(
        causal_networks(state.parameters, config), config, position_inputs, values_in_steps, offset_mask
    )
    return (anchor_value_bits + offsets.sum(dim=1) + POSITION_BITS) * anchor_mask


def anchor_and_offset_bits(
    networks: dict[str, Mlp],
    config: CausalConfig,
    position_inputs: Float[Tensor, "M P"],
    values: Sequence[Tensor],
    offset_mask: Float[Tensor, "M K"],
) -> tuple[Float[Tensor, "M"], Float[Tensor, "M K"]]:
    """Estimates the bits of the attributes of each anchor, and separately the bits of each offset.

    Args:
        networks: The networks by name.
        config: Shapes of anchors and networks.
        position_inputs: Positions of the anchors and their positional encoding, as inputs of the position network.
        values: Features, logarithms and offsets, in quantisation steps, with noise in place of rounding.
        offset_mask: Mask of the offsets that exist, 0 or 1.

    Returns:
        For each anchor, bits of its features and of the logarithms of the offset scale and the sizes, (M). For each
        offset, bits of its coordinates and of its mask, (M, K).
    """
    feature, log_scalings, offset = values
    predicted = predict_causal(_functions(networks), config, position_inputs, feature, log_scalings, join=torch.cat)
    anchor_value_bits = value_bits(
        torch.cat([feature, log_scalings], dim=1), *joined(predicted.feature, predicted.log_scalings)
    ).sum(dim=1)
    offset_value_bits = value_bits(offset, *predicted.offset).view(len(position_inputs), -1, 3).sum(dim=2)
    present_mask_bits, absent_mask_bits = mask_bits(predicted)
    present_bits = offset_value_bits + present_mask_bits
    return anchor_value_bits, offset_mask * present_bits + (1 - offset_mask) * absent_mask_bits


def joined(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Concatenates the predicted normal distributions of two attributes: means, and log2 of standard deviations.

    Args:
        first: Means, and log2 of standard deviations, of the first attribute.
        second: Means, and log2 of standard deviations, of the second attribute.
    """
    return torch.cat([first[0], second[0]], dim=1), torch.cat([first[1], second[1]], dim=1)


def mask_bits(predicted: CausalPrediction) -> tuple[Float[Tensor, "M K"], Float[Tensor, "M K"]]:
    """Returns the coding cost of each offset's mask in bits, for both possible values of the mask.

    Args:
        predicted: Predictions of the causal model.

    Returns:
        Cost if the offset exists, and cost if it does not, (M, K) each.
    """
    softplus = torch.nn.functional.softplus
    return softplus(-predicted.mask_logits) / math.log(2), softplus(predicted.mask_logits) / math.log(2)


def value_bits(
    values: Float[Tensor, "M D"], mean: Float[Tensor, "M D"], log_deviation: Float[Tensor, "M D"]
) -> Float[Tensor, "M D"]:
    """Returns the ideal code length of quantised values under normal distributions, in bits.

    Args:
        values: Values, in quantisation steps.
        mean: Means of the distributions, in quantisation steps.
        log_deviation: log2 of the standard deviations in quantisation steps.
    """
    inverse = torch.exp2(-log_deviation.clamp(*LOG_DEVIATION_RANGE))
    # mirror both bounds to below the mean, where differences of tiny probabilities are precise
    distance = (values - mean).abs()
    return bits(torch.special.ndtr((0.5 - distance) * inverse) - torch.special.ndtr((-0.5 - distance) * inverse))


@torch.no_grad()
def initialise_causal(state: TrainState, config: TrainConfig, position_inputs: Float[Tensor, "N P"]) -> None:
    """Initialises the networks of the causal model so that they predict the mean and deviation of each attribute.

    Also sets the zero points, which are not trained: the mean natural logarithms of the offset scale and the sizes.

    Args:
        state: State of the training; the networks and zero points are changed in place.
        config: The configuration.
        position_inputs: Positions of all anchors and their positional encoding, as inputs of the position network.
    """
    model_config, parameters = config.causal, state.parameters
    alive = state.masks(config.mask_threshold).any(dim=1)
    if int(alive.sum()) < 2:
        return
    parameters["zero_points"].copy_(parameters["log_scalings"][alive].mean(dim=0))
    steps = attribute_steps(parameters["log_steps"], model_config)
    logs = parameters["log_scalings"] - parameters["zero_points"]
    columns = parameters["features"], logs, parameters["offsets"].flatten(1)
    means, log_deviations = [], []
    for values, step in zip(columns, steps, strict=True):
        values = values[alive] / step
        means.append(values.mean(dim=0))
        log_deviations.append(values.std(dim=0).clamp(min=MIN_INITIAL_DEVIATION).log2())
    groups, before = model_config.layout.feature_groups, 0
    start = {}
    for group, size in enumerate(groups):
        part = slice(before, before + size)
        start[f"feature{group}"] = [means[0][part], log_deviations[0][part]]
        before += size
    share = state.masks(config.mask_threshold)[alive].float().mean(dim=0).clamp(0.01, 0.99)
    start[MASK_AND_SCALE] = [torch.logit(share), means[1][:1], log_deviations[1][:1]]
    start["size"] = [means[1][1:], log_deviations[1][1:]]
    start["offset"] = [means[2], log_deviations[2]]
    for name, parts in start.items():
        parameters[f"causal.{name}.output.weight"].mul_(0.3)
        parameters[f"causal.{name}.output.bias"].copy_(torch.cat(parts))
