"""Predicts the distributions of anchor attributes for entropy coding: context model of the schema `causal`.

The functions accept numpy arrays and torch tensors.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.reprs import summary_repr
from splatwire.types.causal_coding import INPUT_UNIT, MASK_AND_SCALE, OCTAVES, CausalConfig


@dataclass(frozen=True, eq=False)
class CausalPrediction:
    """Predicted probability distributions of the attributes of M anchors.

    Means and standard deviations are in quantisation steps. Standard deviations are stored as log2.

    Attributes:
        feature: Means and log2 of standard deviations of the feature channels.
        mask_logits: Predicted probability that each offset exists, as a logit.
        log_scalings: Means and log2 of standard deviations of four logarithms. An anchor has one for the common scale
            of its offsets, and three for the base sizes of its Gaussians along the axes.
        offset: Means and log2 of standard deviations of the offsets.
    """

    feature: tuple[Float[Any, "M F"], Float[Any, "M F"]]
    mask_logits: Float[Any, "M K"]
    log_scalings: tuple[Float[Any, "M 4"], Float[Any, "M 4"]]
    offset: tuple[Float[Any, "M O"], Float[Any, "M O"]]

    __repr__ = summary_repr


def position_inputs(
    coordinates: Float[Any, "M 3"], join: Callable[[list[Any], int], Any] = np.concatenate
) -> Float[Any, "M P"]:
    """Computes the inputs of the position network: positions contracted to (-1, 1), and their positional encoding.

    Args:
        coordinates: Positions relative to `CausalCoding.middle`, divided by `CausalCoding.spread`; of any size.
        join: Concatenates arrays along an axis; `torch.cat` for tensors.
    """
    contracted = coordinates / (1 + abs(coordinates))
    waves = [contracted]
    for octave in range(1, OCTAVES + 1):
        waves.append(abs((contracted * 2.0**octave - 1) % 4 - 2) - 1)
    return join(waves, 1)


def predict_causal(
    networks: Mapping[str, Callable[[Any], Any]],
    config: CausalConfig,
    inputs: Float[Any, "M P"],
    feature: Float[Any, "M F"],
    log_scalings: Float[Any, "M 4"],
    *,
    input_values: Callable[[str, Any, Any], Any] | None = None,
    join: Callable[[list[Any], int], Any] = np.concatenate,
) -> CausalPrediction:
    """Predicts the probability distributions of all attributes of M anchors with the causal context model.

    Attributes are predicted in this order: feature groups, scale of the offsets, base sizes, offsets. The inputs of a
    network are the encoded position and all attributes that come earlier in this order.

    Args:
        networks: Networks of the context model by name, each a function from inputs to outputs.
        config: Configuration of the context model.
        inputs: Encoded positions of the anchors, from `position_inputs`.
        feature: Features of the anchors, in quantisation steps.
        log_scalings: Logarithms of four scalings of each anchor, minus `CausalCoding.zero_points`, in quantisation
            steps: the common scale of its offsets, and the base sizes of its Gaussians along three axes.
        input_values: Function that returns the values to use as inputs of later networks, for example rounded
            attributes. Its arguments are the name of the network that predicted them, the predicted means and the
            attributes. None to use the attributes themselves.
        join: Function that concatenates arrays along an axis; `torch.cat` for tensors.
    """
    known_inputs = networks["position"](inputs)
    means, log_deviations, before = [], [], 0

    def append_input(name: str, mean: Any, values: Any) -> None:
        nonlocal known_inputs
        used = values if input_values is None else input_values(name, mean, values)
        known_inputs = join([known_inputs, used * INPUT_UNIT], 1)

    def predicted(name: str) -> tuple[Any, Any]:
        outputs = networks[name](known_inputs)
        middle = outputs.shape[1] // 2
        return outputs[:, :middle], outputs[:, middle:]

    for group, size in enumerate(config.layout.feature_groups):
        mean, log_deviation = predicted(f"feature{group}")
        append_input(f"feature{group}", mean, feature[:, before : before + size])
        means.append(mean)
        log_deviations.append(log_deviation)
        before += size
    num_mask_logits = config.layout.num_offsets
    outputs = networks[MASK_AND_SCALE](known_inputs)
    mask_logits, scale_mean = outputs[:, :num_mask_logits], outputs[:, num_mask_logits : num_mask_logits + 1]
    scale_log_deviation = outputs[:, num_mask_logits + 1 :]
    append_input(MASK_AND_SCALE, scale_mean, log_scalings[:, :1])
    size_mean, size_log_deviation = predicted("size")
    append_input("size", size_mean, log_scalings[:, 1:])
    return CausalPrediction(
        (join(means, 1), join(log_deviations, 1)), mask_logits,
        (join([scale_mean, size_mean], 1), join([scale_log_deviation, size_log_deviation], 1)),
        predicted("offset"),
    )  # fmt: skip
