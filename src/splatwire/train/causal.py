"""The causal model in training: noise as wide as the learnt steps, and the rate of a sample of anchors."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.entropy.rate import bits
from splatwire.model import Linear, Mlp
from splatwire.model.causal import FORM, CausalConfig
from splatwire.model.causal_prediction import CausalPrediction, place_inputs, predict_causal
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache, SampleRate, Seen, straight_through_masks
from splatwire.train.initial import place_bounds
from splatwire.train.kernels import Kernels, Uniform
from splatwire.train.schedule import Phase, phase_of
from splatwire.train.state import CHANNEL_SLOPE, TrainState, expanded_scalings

RATE_UNIT = 8e6
"""Lambda is per megabyte of the whole scene."""
POSITION_BITS = 16.0
"""What the place of an anchor costs, about: anchors that draw little are to know it."""
SPREADS = (-6.0, 13.0)
"""Bounds of the binary logarithms of spreads, in steps."""
NARROW = 0.5
"""Spreads, in steps, that training starts from are at least this."""


class TrainedCausal:
    """The causal model as an iteration meets it.

    Args:
        config: The recipe.
        kernels: What does the heavy parts.
        cache: Where the anchors are.
    """

    def __init__(self, config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> None:
        self._config, self._random, self._cache = config, kernels.random, cache
        self._model = config.causal
        self._key: Tensor | None = None
        self._inputs: Tensor | None = None

    def begin(self, state: TrainState) -> None:
        """Gets ready before the first iteration of the context phase; does nothing before any other."""
        if state.iteration == self._config.marks.context_start + 1:
            state.bounds_min, state.bounds_max = place_bounds(state.voxels)
            self._key = None
            calibrate_causal(state, self._config, self.place(state))

    def place(self, state: TrainState) -> Float[Tensor, "N P"]:
        """Inputs of the position network for all anchors; computed again only when these change."""
        if self._inputs is None or self._key is not state.voxels:
            self._key, self._inputs = state.voxels, place_of(state)
        return self._inputs

    def observe(self, state: TrainState, visible: Int64[Tensor, "M"]) -> tuple[Seen, SampleRate | None]:
        """Returns what is drawn of the visible anchors, and the rate of a sample of all as far as the phase has one."""
        config, phase = self._config, phase_of(self._config.marks, state.iteration)
        masks = straight_through_masks(state, config, visible)[0]
        if phase is Phase.PLAIN:
            return (state.attributes(visible), masks.detach()), None
        steps = channel_steps(state.parameters["steps"], self._model)
        if phase is Phase.NOISE:
            steps = (steps[0].detach(), steps[1].detach(), steps[2].detach())
        feature, logs, offsets = noisy_numbers(state, visible, steps, self._random.uniform)
        drawn = feature, expanded_scalings(logs.exp()), offsets
        if phase is Phase.NOISE:  # what an offset is worth shows only beside what it costs
            return (drawn, masks.detach()), None
        share = config.weights.sample_share
        sample = self._random.sample(state.num_anchors, share, state.generator, state.device)
        return (drawn, masks), self._rate(state, sample, steps)

    def expected_scalings(self, state: TrainState, index: Int64[Tensor, "M"]) -> Float[Tensor, "M 6"]:
        """The scalings that are expected of anchors of which nothing is known but their places."""
        place, layout = self.place(state)[index], self._model.layout
        networks, nothing = causal_networks(state.parameters, self._model), place.new_zeros(len(place), 1)
        predicted = predict_causal(
            networks, self._model, place, nothing.expand(-1, layout.feature_dim), nothing.expand(-1, FORM),
            quantised=lambda name, mean, values: mean,
        )  # fmt: skip
        steps = channel_steps(state.parameters["steps"], self._model)[1]
        return expanded_scalings((predicted.form[0] * steps + state.parameters["centres"]).exp())

    def rate_loss(self, state: TrainState, rate: SampleRate) -> Float[Tensor, ""]:
        """Lambda times the megabytes of the scene, estimated from a sample."""
        share = state.num_anchors / max(rate.num_anchors, 1)
        return state.rate(self._config.weights) * rate.bits * share / RATE_UNIT

    def _rate(self, state: TrainState, sample: Int64[Tensor, "M"], steps: tuple[Tensor, Tensor, Tensor]) -> SampleRate:
        masks = straight_through_masks(state, self._config, sample)
        values = noisy_numbers(state, sample, steps, self._random.uniform)
        total = anchor_bits(state, self._model, self.place(state)[sample], values, steps, masks)
        return SampleRate(total.sum(), len(sample))


def place_of(state: TrainState) -> Float[Tensor, "N P"]:
    """Inputs of the position network for all anchors."""
    middle, spread = (state.bounds_max + state.bounds_min) / 2, (state.bounds_max - state.bounds_min) / 2
    return place_inputs((state.voxels - middle) / spread)


def channel_steps(logs: Float[Tensor, "S"], config: CausalConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Steps of each feature channel, of each logarithm of the form, and of the offsets."""
    steps, groups = logs.exp(), config.layout.feature_groups
    repeats = torch.tensor(groups, device=logs.device)
    feature = steps[: len(groups)].repeat_interleave(repeats)
    scale, size, offset = steps[len(groups) :]
    return feature, torch.stack([scale, size, size, size]), offset


def noisy_numbers(
    state: TrainState, index: Int64[Tensor, "M"], steps: tuple[Tensor, ...], uniform: Uniform
) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M 4"], Float[Tensor, "M O"]]:
    """Features, logarithms of scale and size, and offsets with uniform noise as wide as their steps.

    Offsets are relative to the scale that a decoder has, so that its rounding moves no Gaussian.
    """

    def noisy(values: Tensor, step: Tensor) -> Tensor:
        return values + (uniform(values.shape, state.generator, values.device) - 0.5) * step

    parameters = state.parameters
    before = parameters["log_scalings"][index]
    feature, logs = noisy(parameters["features"][index], steps[0]), noisy(before, steps[1])
    offsets = parameters["offsets"][index].flatten(1) * (before[:, :1] - logs[:, :1]).exp()
    return feature, logs, noisy(offsets, steps[2])


def causal_networks(parameters: dict[str, Tensor], config: CausalConfig) -> dict[str, Mlp]:
    """The networks over the tensors of a state."""

    def layer(name: str) -> Linear:
        return Linear(parameters[f"causal.{name}.weight"], parameters[f"causal.{name}.bias"])

    return {name: Mlp(layer(f"{name}.hidden"), layer(f"{name}.output"), CHANNEL_SLOPE) for name in config.shapes()}


def anchor_bits(
    state: TrainState,
    config: CausalConfig,
    place: Float[Tensor, "M P"],
    values: tuple[Tensor, Tensor, Tensor],
    steps: tuple[Tensor, Tensor, Tensor],
    masks: tuple[Tensor, Tensor],
) -> Float[Tensor, "M"]:
    """Estimates the bits of anchors."""
    logs = values[1] - state.parameters["centres"].detach()
    numbers = [value / step for value, step in zip((values[0], logs, values[2]), steps, strict=True)]
    offset_mask, anchor_mask = masks
    own, offsets = number_bits_of(causal_networks(state.parameters, config), config, place, numbers, offset_mask)
    return (own + offsets.sum(dim=1) + POSITION_BITS) * anchor_mask


def number_bits_of(
    networks: dict[str, Mlp],
    config: CausalConfig,
    place: Float[Tensor, "M P"],
    numbers: Sequence[Tensor],
    offset_mask: Float[Tensor, "M K"],
) -> tuple[Float[Tensor, "M"], Float[Tensor, "M K"]]:
    """Bits of anchors' features and logarithms, and of each offset with its existence.

    Args:
        networks: By name.
        config: Shapes.
        place: Inputs of the position network.
        numbers: Features, logarithms and offsets, in steps, with noise in place of rounding.
        offset_mask: Which offsets exist.
    """
    feature, form, offset = numbers
    predicted = predict_causal(networks, config, place, feature, form)
    own = number_bits(torch.cat([feature, form], dim=1), *joined(predicted.feature, predicted.form)).sum(dim=1)
    each = number_bits(offset, *predicted.offset).view(len(place), -1, 3).sum(dim=2)
    one, zero = mask_bits(predicted)
    return own, offset_mask * (each + one) + (1 - offset_mask) * zero


def joined(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Means and spreads of two kinds of numbers side by side."""
    return torch.cat([first[0], second[0]], dim=1), torch.cat([first[1], second[1]], dim=1)


def mask_bits(predicted: CausalPrediction) -> tuple[Float[Tensor, "M K"], Float[Tensor, "M K"]]:
    """Bits that it takes to say that an offset exists, and that it does not."""
    softplus = torch.nn.functional.softplus
    return softplus(-predicted.exists) / math.log(2), softplus(predicted.exists) / math.log(2)


def number_bits(
    values: Float[Tensor, "M D"], mean: Float[Tensor, "M D"], spread: Float[Tensor, "M D"]
) -> Float[Tensor, "M D"]:
    """Bits of numbers in steps under normals whose spreads are powers of two."""
    inverse = torch.exp2(-spread.clamp(*SPREADS))
    # both bounds on the lower side of the mean: there differences of tiny probabilities keep their digits
    distance = (values - mean).abs()
    return bits(torch.special.ndtr((0.5 - distance) * inverse) - torch.special.ndtr((-0.5 - distance) * inverse))


@torch.no_grad()
def calibrate_causal(state: TrainState, config: TrainConfig, place: Float[Tensor, "N P"]) -> None:
    """Lets the networks start from the mean and spread that the numbers have by now."""
    model, parameters = config.causal, state.parameters
    alive = state.masks(config.mask_threshold).any(dim=1)
    if int(alive.sum()) < 2:
        return
    parameters["centres"].copy_(parameters["log_scalings"][alive].mean(dim=0))
    steps = channel_steps(parameters["steps"], model)
    logs = parameters["log_scalings"] - parameters["centres"]
    columns = parameters["features"], logs, parameters["offsets"].flatten(1)
    means, spreads = [], []
    for values, step in zip(columns, steps, strict=True):
        values = values[alive] / step
        means.append(values.mean(dim=0))
        spreads.append(values.std(dim=0).clamp(min=NARROW).log2())
    groups, before = model.layout.feature_groups, 0
    start = {}
    for group, size in enumerate(groups):
        part = slice(before, before + size)
        start[f"feature{group}"] = [means[0][part], spreads[0][part]]
        before += size
    share = state.masks(config.mask_threshold)[alive].float().mean(dim=0).clamp(0.01, 0.99)
    start["form"] = [torch.logit(share), means[1][:1], spreads[1][:1]]
    start["size"] = [means[1][1:], spreads[1][1:]]
    start["offset"] = [means[2], spreads[2]]
    for name, parts in start.items():
        parameters[f"causal.{name}.output.weight"].mul_(0.3)
        parameters[f"causal.{name}.output.bias"].copy_(torch.cat(parts))
