"""The causal context model in floats: the oracle of the codec's integers, and the part that training differentiates."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.causal import INPUT_UNIT, OCTAVES, CausalConfig
from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class CausalPrediction:
    """Distributions of the numbers of M anchors: means, and binary logarithms of standard deviations, both in steps.

    Attributes:
        feature: Means and spreads of the feature.
        exists: Logits of the offsets' existence.
        form: Means and spreads of the four logarithms.
        offset: Means and spreads of the offsets.
    """

    feature: tuple[Float[Tensor, "M F"], Float[Tensor, "M F"]]
    exists: Float[Tensor, "M K"]
    form: tuple[Float[Tensor, "M 4"], Float[Tensor, "M 4"]]
    offset: tuple[Float[Tensor, "M O"], Float[Tensor, "M O"]]

    __repr__ = summary_repr


def place_inputs(coordinates: Float[Tensor, "M 3"]) -> Float[Tensor, "M P"]:
    """Inputs of the position network: contracted coordinates, and triangle waves of them, each twice as fast.

    Args:
        coordinates: Places relative to the middle, in spreads.
    """
    contracted = coordinates / (1 + coordinates.abs())
    waves = [contracted]
    for octave in range(1, OCTAVES + 1):
        waves.append(((contracted * 2.0**octave - 1).remainder(4) - 2).abs() - 1)
    return torch.cat(waves, dim=1)


def predict_causal(
    networks: Mapping[str, Callable[[Tensor], Tensor]],
    config: CausalConfig,
    inputs: Float[Tensor, "M P"],
    feature: Float[Tensor, "M F"],
    form: Float[Tensor, "M 4"],
    *,
    quantised: Callable[[str, Tensor, Tensor], Tensor] | None = None,
) -> CausalPrediction:
    """Evaluates all networks; differentiable.

    Args:
        networks: By name.
        config: Shapes.
        inputs: Of `place_inputs`.
        feature: Features in steps.
        form: Logarithms of scale and size in steps from their centres.
        quantised: Makes of a network's name, means and these numbers those that a decoder will have; they are taken as
            they are if absent.
    """
    known = networks["position"](inputs)
    means, spreads, before = [], [], 0

    def follow(name: str, mean: Tensor, values: Tensor) -> None:
        nonlocal known
        found = values if quantised is None else quantised(name, mean, values)
        known = torch.cat([known, found * INPUT_UNIT], dim=1)

    for group, size in enumerate(config.layout.feature_groups):
        mean, spread = networks[f"feature{group}"](known).chunk(2, dim=1)
        follow(f"feature{group}", mean, feature[:, before : before + size])
        means.append(mean)
        spreads.append(spread)
        before += size
    exists, scale_mean, scale_spread = networks["form"](known).split([config.layout.num_offsets, 1, 1], dim=1)
    follow("form", scale_mean, form[:, :1])
    size_mean, size_spread = networks["size"](known).chunk(2, dim=1)
    follow("size", size_mean, form[:, 1:])
    offset_mean, offset_spread = networks["offset"](known).chunk(2, dim=1)
    return CausalPrediction(
        (torch.cat(means, dim=1), torch.cat(spreads, dim=1)), exists,
        (torch.cat([scale_mean, size_mean], dim=1), torch.cat([scale_spread, size_spread], dim=1)),
        (offset_mean, offset_spread),
    )  # fmt: skip
