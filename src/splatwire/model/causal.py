"""The causal context model: what an anchor's numbers are predicted from is its own place and its own numbers before.

Nothing is shared by anchors but the networks, so a packet needs nothing of any other. Numbers are coded in an order:
the feature in groups, the first of which are single channels and serve as latents of all that follows; which offsets
exist, and their common scale; the base size of the Gaussians; the offsets. Each network reads the place and everything
before. All numbers are in quantisation steps here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.networks import Mlp
from splatwire.reprs import summary_repr
from splatwire.scene import AnchorLayout

OCTAVES = 4
"""Frequencies of a coordinate that the position network reads besides the coordinate itself."""
INPUT_UNIT = 0.25
"""What a step counts as where a number is an input of a network."""
FORM = 4
"""Numbers of an anchor's form: the logarithm of the offsets' scale, and those of the base size along three axes."""


@dataclass(frozen=True)
class CausalConfig:
    """Shape of the causal context model.

    Attributes:
        layout: Sizes of an anchor.
        context_dim: Numbers that a place is described by.
    """

    layout: AnchorLayout = field(default_factory=lambda: AnchorLayout(32, 10, (1, 1, 2, 4, 8, 16)))
    context_dim: int = 16

    @property
    def num_steps(self) -> int:
        """Quantisation steps: one for each feature group, then of the scale, the size and the offsets."""
        return len(self.layout.feature_groups) + 3

    def shapes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of every network, in the order in which they are evaluated."""
        features, offsets, c = self.layout.feature_dim, self.layout.num_offsets, self.context_dim
        shapes, before = {"position": (3 * (1 + OCTAVES), c)}, 0
        for group, size in enumerate(self.layout.feature_groups):
            shapes[f"feature{group}"] = (c + before, 2 * size)
            before += size
        shapes["form"] = (c + features, offsets + 2)
        shapes["size"] = (c + features + 1, 6)
        shapes["offset"] = (c + features + FORM, 6 * offsets)
        return shapes


@dataclass(frozen=True, eq=False)
class CausalCoding:
    """What schema `causal` codes a scene with; nothing that draws reads it.

    Attributes:
        networks: The networks of `CausalConfig.shapes`, by name.
        steps: Quantisation steps, in the order of `CausalConfig.num_steps`; those of scale and size are of logarithms.
        centres: What stands for zero of the four logarithms of an anchor's form.
        middle: Middle of the scene, voxels.
        spread: Its extent along each axis, voxels: half of the anchors are about this near to the middle.
        voxel_size: Spacing of anchor positions, world units.
        config: Shapes.
    """

    networks: dict[str, Mlp]
    steps: Float[Tensor, "S"]
    centres: Float[Tensor, "4"]
    middle: Float[Tensor, "3"]
    spread: Float[Tensor, "3"]
    voxel_size: float
    config: CausalConfig

    __repr__ = summary_repr


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
