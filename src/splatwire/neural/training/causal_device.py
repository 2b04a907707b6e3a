"""Training of the causal context model on a GPU."""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.model.tensors import run_network
from splatwire.neural.training.causal import (
    LOG_DEVIATION_RANGE,
    POSITION_BITS,
    RATE_UNIT,
    TrainableCausal,
    causal_networks,
)
from splatwire.neural.training.context import MaskedAttributes, SampleBits, straight_through
from splatwire.neural.training.packed import pack_networks
from splatwire.neural.training.rate import MIN_LIKELIHOOD
from splatwire.neural.training.schedule import Phase, phase_of
from splatwire.neural.training.state import CONTEXT_NEGATIVE_SLOPE, TrainState, expanded_scalings
from splatwire.types import Mlp
from splatwire.types.causal_coding import INPUT_UNIT, MASK_AND_SCALE, NUM_LOG_SCALINGS, CausalConfig

_CHUNK = 1 << 16
"""Number of anchors per chunk of the bit estimate."""


class DeviceCausal(TrainableCausal):
    """Trainer of the causal context model on a GPU.

    Arguments are the same as for `TrainableCausal`.
    """

    # Needs fewer GPU operations than `TrainableCausal`, with the same results: visible and sampled anchors are
    # processed together, and all networks except the position network are packed into one.

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
        config, layout = self._config, self._causal_config.layout
        phase = phase_of(config.milestones, state.iteration)
        widths = (layout.feature_dim, NUM_LOG_SCALINGS, 3 * layout.num_offsets)
        index = visible
        if phase is Phase.CONTEXT:
            noise = self._random.noise(len(visible), widths, state.generator, state.device)
            share = config.weights.sample_share
            sample = self._random.sample(state.num_anchors, share, state.generator, state.device)
            sample_noise = self._random.noise(len(sample), widths, state.generator, state.device)
            index, noise = torch.cat([visible, sample]), torch.cat([noise, sample_noise])
        elif phase is Phase.NOISE:
            noise = self._random.noise(len(visible), widths, state.generator, state.device)
        features, logs, offsets, logits = (
            state.parameters[name].index_select(0, index)
            for name in ("features", "log_scalings", "offsets", "mask_logits")
        )
        offsets = offsets.flatten(1)
        masks, any_mask = straight_through(logits, config.mask_threshold)
        if phase is Phase.PLAIN:
            return ((features, expanded_scalings(logs.exp()), offsets), masks.detach()), None
        steps = value_steps(state.parameters["log_steps"], self._causal_config)
        noise = noise.sub_(0.5) * (steps.detach() if phase is Phase.NOISE else steps)
        offset_scale_noise, _ = noise.split(
            [layout.feature_dim, 1, NUM_LOG_SCALINGS - 1 + 3 * layout.num_offsets], dim=1
        )[1:]
        feature_noise, log_noise, offset_noise = noise.split(list(widths), dim=1)
        noisy = (
            features + feature_noise, logs + log_noise,
            torch.addcmul(offset_noise, offsets, (-offset_scale_noise).exp()),
        )  # fmt: skip
        if phase is Phase.NOISE:
            return ((noisy[0], expanded_scalings(noisy[1].exp()), noisy[2]), masks.detach()), None
        counts = [len(visible), len(sample)]
        (visible_features, sampled_features), (visible_logs, sampled_logs), (visible_offsets, sampled_offsets) = (
            values.split(counts) for values in noisy
        )
        (visible_masks, sampled_masks), (_, sampled_any_mask) = masks.split(counts), any_mask.split(counts)
        sampled = sampled_features, sampled_logs, sampled_offsets
        total = self._bits(state, sample, sampled, steps, (sampled_masks, sampled_any_mask))
        visible_attributes = visible_features, expanded_scalings(visible_logs.exp()), visible_offsets
        return (visible_attributes, visible_masks), SampleBits(total, len(sample))

    def _bits(
        self,
        state: TrainState,
        index: Int64[Tensor, "M"],
        noisy: tuple[Tensor, Tensor, Tensor],
        steps: Float[Tensor, "D"],
        masks: tuple[Tensor, Tensor],
    ) -> Float[Tensor, ""]:
        """Estimates the total bits of some anchors: attribute values, offset masks and positions.

        Args:
            state: State of the training.
            index: Indices of the M anchors in the training state.
            noisy: Features, logarithms of offset scale and sizes, and offsets, with noise in place of rounding.
            steps: Quantisation step of each attribute value (`value_steps`).
            masks: Masks of offsets and of anchors, 0 or 1. Gradients pass through the masks to their logits.
        """
        (feature, logs, offsets), (offset_mask, anchor_mask) = noisy, masks
        values = torch.cat([feature, logs - state.parameters["zero_points"].detach(), offsets], dim=1) / steps
        inputs = self._position_inputs(state).index_select(0, index)
        networks = causal_networks(state.parameters, self._causal_config)
        return (packed_anchor_bits(networks, self._causal_config, inputs, values, offset_mask) * anchor_mask).sum()

    @torch.no_grad()
    def estimate_bytes(self, state: TrainState) -> float:
        """Estimates the bytes of all anchors in the stream."""
        # Noise in place of rounding, with a fixed seed.
        generator, config, parameters = torch.Generator().manual_seed(0), self._config, state.parameters
        steps, total = value_steps(parameters["log_steps"], self._causal_config), list[Tensor]()
        widths = (self._causal_config.layout.feature_dim, NUM_LOG_SCALINGS, 3 * self._causal_config.layout.num_offsets)
        for index in torch.arange(state.num_anchors, device=state.device).split(_CHUNK):
            noise = (self._random.noise(len(index), widths, generator, state.device) - 0.5) * steps
            feature_noise, log_noise, offset_noise = noise.split(list(widths), dim=1)
            noisy = (
                parameters["features"][index] + feature_noise, parameters["log_scalings"][index] + log_noise,
                parameters["offsets"][index].flatten(1) * (-log_noise[:, :1]).exp() + offset_noise,
            )  # fmt: skip
            masks = straight_through(parameters["mask_logits"][index], config.mask_threshold)
            total.append(self._bits(state, index, noisy, steps, masks))
        return float(torch.stack(total).sum()) / 8

    def rate_loss(self, state: TrainState, estimated_bits: SampleBits) -> Float[Tensor, ""]:
        """Returns the rate term of the loss: lambda times the estimated size of the scene in megabytes."""
        scale_to_all = state.num_anchors / max(estimated_bits.num_anchors, 1)
        return estimated_bits.bits * (state.current_lambda(self._config.weights) * scale_to_all / RATE_UNIT)


def value_steps(log_steps: Float[Tensor, "S"], config: CausalConfig) -> Float[Tensor, "D"]:
    """Returns the quantisation step of each attribute value of an anchor.

    The values are the features, the logarithms of the offset scale and the sizes, and the offsets.

    Args:
        log_steps: Natural logarithms of the trained quantisation steps.
        config: Shapes of anchors and networks.
    """
    return log_steps.exp().index_select(0, _step_of_column(config, log_steps.device))


@lru_cache(maxsize=8)
def _step_of_column(config: CausalConfig, device: torch.device) -> Int64[Tensor, "D"]:
    groups = config.layout.feature_groups
    counts = torch.tensor([*groups, 1, NUM_LOG_SCALINGS - 1, 3 * config.layout.num_offsets])
    return torch.arange(len(groups) + 3).repeat_interleave(counts).to(device)


def packed_anchor_bits(
    networks: dict[str, Mlp],
    config: CausalConfig,
    position_inputs: Float[Tensor, "M P"],
    values: Float[Tensor, "M D"],
    offset_mask: Float[Tensor, "M K"],
) -> Float[Tensor, "M"]:
    """Estimates the bits of each anchor: attribute values, offset mask and position.

    All networks except the position network are evaluated as a single one.

    Args:
        networks: The networks by name.
        config: Shapes of anchors and networks.
        position_inputs: Positions of the anchors and their positional encoding, as inputs of the position network.
        values: Features, logarithms of the offset scale and the sizes, and offsets, in quantisation steps, with noise
            in place of rounding.
        offset_mask: Mask of the offsets that exist, 0 or 1.
    """
    layout, order = config.layout, _output_order(config)
    num_anchor_values = layout.feature_dim + NUM_LOG_SCALINGS
    position, *others = (networks[name] for name in config.shapes())
    packed = pack_networks(others, order.outputs)
    inputs, _ = values.split([num_anchor_values, 3 * layout.num_offsets], dim=1)
    hidden = torch.cat([run_network(position, position_inputs), inputs * INPUT_UNIT], dim=1)
    outputs = packed(hidden, CONTEXT_NEGATIVE_SLOPE)
    mean, log_deviation, mask_logits = outputs.split([order.num_values, order.num_values, layout.num_offsets], dim=1)
    all_bits = _ValueBits.apply(values, mean, log_deviation)
    anchor_value_bits, offset_value_bits = all_bits.split([num_anchor_values, 3 * layout.num_offsets], dim=1)
    # the mask bit costs softplus(-x) if the offset exists, otherwise softplus(x); the difference is x
    absent_bits = torch.nn.functional.softplus(mask_logits).mul(1 / math.log(2))
    extra_bits = offset_value_bits.view(len(position_inputs), -1, 3).sum(dim=2).add(mask_logits, alpha=-1 / math.log(2))
    return anchor_value_bits.sum(dim=1) + (offset_mask * extra_bits + absent_bits).sum(dim=1) + POSITION_BITS


class _ValueBits(torch.autograd.Function):
    """Autograd function that computes the bits of quantised values (`causal.value_bits`), and their gradient."""

    # `a` and `b` are the bounds of a value's quantisation interval, measured from the mean in units of sqrt(2) standard
    # deviations. The probability of the value is half of `erfc(a) - erfc(b)`.

    @staticmethod
    def forward(ctx: Any, values: Tensor, mean: Tensor, log_deviation: Tensor) -> Tensor:
        bounded, difference = log_deviation.clamp(*LOG_DEVIATION_RANGE), values - mean
        inverse = torch.rsub(bounded, -0.5).exp2_()
        a = difference.abs().sub_(0.5).mul_(inverse)
        b = a + inverse
        share = torch.erfc(a).sub_(torch.erfc(b)).mul_(0.5)
        bounded_share = share.clamp(min=MIN_LIKELIHOOD)
        weight = (share >= MIN_LIKELIHOOD) / bounded_share
        near, far = (a * a).neg_().exp_(), (b * b).neg_().exp_()
        d_log_deviation = (far * b).addcmul_(near, a, value=-1).mul_(weight).mul_(log_deviation == bounded)
        d_value = near.sub_(far).mul_(inverse).mul_(weight).mul_(difference.sign_())
        ctx.save_for_backward(d_value, d_log_deviation)
        return bounded_share.log2_().neg_()

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        d_value, d_log_deviation = ctx.saved_tensors
        value = (upstream[0] * d_value).mul_(1 / (math.sqrt(math.pi) * math.log(2)))
        return value, -value, (upstream[0] * d_log_deviation).mul_(1 / math.sqrt(math.pi))


@dataclass(frozen=True)
class _OutputOrder:
    """Order of the outputs of the combined network, which evaluates all networks but the position network at once.

    All means come first, then all standard deviations, then the logits of offset masks.

    Attributes:
        outputs: For each output in this order, its index in the concatenated outputs of the separate networks.
        num_values: Number of attribute values per anchor; each has a mean and a standard deviation.
    """

    outputs: tuple[int, ...]
    num_values: int


@lru_cache(maxsize=8)
def _output_order(config: CausalConfig) -> _OutputOrder:
    names = [name for name in config.shapes() if name != "position"]
    sizes = [config.shapes()[name][1] for name in names]
    first = dict(zip(names, accumulate([0, *sizes[:-1]]), strict=True))
    means, log_deviations, mask_logits = list[int](), list[int](), list[int]()
    for name, size in zip(names, sizes, strict=True):
        outputs = list(range(first[name], first[name] + size))
        if name == MASK_AND_SCALE:
            mask_logits, outputs = outputs[:-2], outputs[-2:]
        half = len(outputs) // 2
        means, log_deviations = means + outputs[:half], log_deviations + outputs[half:]
    return _OutputOrder(tuple(means + log_deviations + mask_logits), len(means))
