"""A finished scene's context model, fitted once more: fewer bits for the same numbers.

While pictures are learned, the context model chases attributes that move, and sees a twentieth of them at a time. Here
attributes and steps stand still and no picture is drawn, so that a minute brings what the run had no time for: the bits
of all attributes under the coder's own distributions (HAC++, rate) and those of the grid's signs become fewer, signs
that no longer pay are turned back, and the scene looks as before.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.model import AnchorScene, CausalCoding, ContextModel, HashGrid, HashGridConfig, Linear, Mlp, ModelConfig
from splatwire.model.hash_grid import unit_coordinates
from splatwire.model.prior_field import PriorOutputs, split_prior_outputs, typical_spread
from splatwire.model.tensors import to_tensors
from splatwire.ops.arrays import to_arrays
from splatwire.scene import Anchors
from splatwire.train.config import RefineConfig
from splatwire.train.context import AttributeBits, adaptive_steps, attribute_bits
from splatwire.train.export import copied_mlp
from splatwire.train.fit import fit_samples
from splatwire.train.grid import GridCorners, find_corners, hard_sign, interpolate_signs, straight_through_sign
from splatwire.train.refine_causal import refine_causal

_CHUNK = 8192
_STEP_SCALE = 0.2
"""Unit of the logits of the steps, where other outputs have the spread that they predict."""


@dataclass(frozen=True, eq=False)
class _Fixed:
    """What stays as it is.

    Attributes:
        config: Shape of the model.
        corners: The anchors in the hash grid.
        logits: Logits of the steps before.
        steps: The steps.
        values: Features, scalings and offsets, rounded to their steps.
        mask: Which offsets exist.
    """

    config: ModelConfig
    corners: GridCorners
    logits: Float[Tensor, "N 3"]
    steps: Float[Tensor, "N 3"]
    values: tuple[Tensor, Tensor, Tensor]
    mask: Float[Tensor, "N K"]


class _ScaledMlp:
    """A network in training whose outputs are in units of their own: one learning rate suits scalings and features."""

    def __init__(self, mlp: Mlp, unit: Float[Tensor, "out"]) -> None:
        self._slope, self._unit = mlp.negative_slope, unit
        hidden, output = mlp.hidden, mlp.output
        start = (hidden.weight, hidden.bias, output.weight / unit[:, None], output.bias / unit)
        self.parameters = [tensor.detach().clone().requires_grad_() for tensor in start]

    def mlp(self) -> Mlp:
        """The network as it stands, differentiable."""
        weight, bias, output, output_bias = self.parameters
        return Mlp(Linear(weight, bias), Linear(output * self._unit[:, None], output_bias * self._unit), self._slope)


class _Signs:
    """The grid's signs in training: a latent number behind each, and what the coder pays for a sign of its level."""

    def __init__(self, grid: HashGrid, config: HashGridConfig, corners: GridCorners, latent: float) -> None:
        self.volume = (grid.volume.float() * latent).requires_grad_()
        self.planes = (grid.planes.float() * latent).requires_grad_()
        self._level = _level_of_row(config)
        self._read = torch.zeros(len(self._level))
        self._read[torch.cat([corners.volume_rows.flatten(), corners.plane_rows.flatten()]).long()] = 1

    def bits(self) -> Float[Tensor, ""]:
        """Bits of the signs that some anchor reads, each column of each level under its own frequency."""
        signs = torch.cat([straight_through_sign(self.volume), straight_through_sign(self.planes).flatten(0, 1)])
        with torch.no_grad():
            levels = int(self._level.max()) + 1
            rows = torch.zeros(levels).index_add_(0, self._level, self._read)[:, None]
            ones = torch.zeros(levels, signs.shape[1])
            ones.index_add_(0, self._level, (signs > 0).float() * self._read[:, None])
            share = (ones + 0.5) / (rows + 1)
            plus, minus = -torch.log2(share)[self._level], -torch.log2(1 - share)[self._level]
        each = (1 + signs) / 2 * plus + (1 - signs) / 2 * minus
        return (each * self._read[:, None]).sum()

    def grid(self, grid: HashGrid) -> HashGrid:
        """The grid with the signs as they stand."""
        volume, planes = (hard_sign(table.detach()).to(torch.int8) for table in (self.volume, self.planes))
        return HashGrid(volume, planes, grid.bounds_min, grid.bounds_max)


def refine_context(
    scene: AnchorScene, config: RefineConfig | None = None, *, progress: Callable[[float], None] = lambda share: None
) -> AnchorScene:
    """Fits the context model of a scene again; anchors, rendering networks and (nearly) steps stay.

    Args:
        scene: The scene, on the CPU.
        config: How long and how fast.
        progress: Called with the share that is done.

    Returns:
        The scene with another context model; the same one if there is nothing to do.

    Raises:
        DivergedError: If the bits stop being finite.
    """
    config, given = config or RefineConfig(), scene
    if isinstance(scene.coding, CausalCoding):
        return refine_causal(scene, config, progress=progress)
    scene = to_tensors(scene)
    alive = scene.anchors.mask.any(dim=1).nonzero()[:, 0]
    if not config.steps or not len(alive):
        return given
    fixed, outputs = _fixed(scene, scene.anchors.select(alive))
    units = _units(outputs, scene.hacpp.config)
    prior = _ScaledMlp(scene.hacpp.context.prior, units[0])
    channels = [_ScaledMlp(mlp, unit) for mlp, unit in zip(scene.hacpp.context.channel, units[1:], strict=True)]
    signs = _Signs(scene.hacpp.context.grid, scene.hacpp.config.grid, fixed.corners, config.latent)
    networks = [tensor for part in (prior, *channels) for tensor in part.parameters]
    fit_samples(
        [(networks, config.network_rate), ([signs.volume, signs.planes], config.grid_rate)], len(alive), config,
        lambda index, _: _loss(fixed, prior, channels, signs, index, config), progress,
    )  # fmt: skip
    context = ContextModel(
        signs.grid(scene.hacpp.context.grid),
        copied_mlp(prior.mlp()),
        tuple(copied_mlp(part.mlp()) for part in channels),
    )
    return dataclasses.replace(given, coding=dataclasses.replace(given.hacpp, context=to_arrays(context)))


def _loss(
    fixed: _Fixed,
    prior: _ScaledMlp,
    channels: list[_ScaledMlp],
    signs: _Signs,
    index: Int64[Tensor, "M"],
    config: RefineConfig,
) -> Float[Tensor, ""]:
    """Bits of the whole scene per anchor, estimated from some; steps that leave their place count as bits, too."""
    outputs = split_prior_outputs(
        prior.mlp()(interpolate_signs(signs.volume, signs.planes, fixed.corners, index)), fixed.config
    )
    layout = fixed.config.layout
    found = attribute_bits(
        outputs, tuple(part.mlp() for part in channels), layout.feature_groups, fixed.steps[index],
        (fixed.values[0][index], fixed.values[1][index], fixed.values[2][index]),
    )  # fmt: skip
    moved = (outputs.step_logits - fixed.logits[index]).square().sum()
    own = (_existing_bits(found, fixed.mask[index]) + config.step_weight * moved) / len(index)
    return own + config.grid_weight * signs.bits() / len(fixed.logits)


def _existing_bits(found: AttributeBits, mask: Float[Tensor, "M K"]) -> Float[Tensor, ""]:
    offsets = found.offsets.view(len(mask), mask.shape[1], 3).sum(dim=2)
    return found.features.sum() + found.scalings.sum() + (offsets * mask).sum()


@torch.no_grad()
def _fixed(scene: AnchorScene, anchors: Anchors) -> tuple[_Fixed, PriorOutputs]:
    """What stays, and what the prior network says before."""
    corners = find_corners(unit_coordinates(scene.hacpp.context.grid, anchors.positions), scene.hacpp.config.grid)
    volume, planes = scene.hacpp.context.grid.volume.float(), scene.hacpp.context.grid.planes.float()
    parts = [
        scene.hacpp.context.prior(interpolate_signs(volume, planes, corners, index))
        for index in torch.arange(anchors.num_anchors).split(_CHUNK)
    ]
    outputs = split_prior_outputs(torch.cat(parts), scene.hacpp.config)
    steps = adaptive_steps(outputs.step_logits, scene.hacpp.config)
    values = (anchors.features, anchors.scalings, anchors.offsets.flatten(1))
    features, scalings, offsets = (
        (value / step).round() * step for value, step in zip(values, steps.split(1, dim=1), strict=True)
    )
    fixed = _Fixed(
        scene.hacpp.config, corners, outputs.step_logits, steps, (features, scalings, offsets), anchors.mask.float()
    )
    return fixed, outputs


def _units(outputs: PriorOutputs, config: ModelConfig) -> list[Float[Tensor, "out"]]:
    """Units of the prior network's outputs, then of each channel network's: the spread that they speak of."""
    scales = (outputs.feature_scale, outputs.scaling_scale, outputs.offset_scale)
    feature, scaling, offset = (
        typical_spread(scale, step) for scale, step in zip(scales, config.base_steps, strict=True)
    )
    one = torch.ones_like(feature)
    units = [torch.cat([feature, feature, one, scaling, scaling, offset, offset, torch.full((3,), _STEP_SCALE)])]
    for part in feature.split(list(config.layout.feature_groups)):
        units.append(torch.cat([part, part, torch.ones_like(part)]))
    return units


def _level_of_row(config: HashGridConfig) -> Int64[Tensor, "rows"]:
    """The level of each row of the tables, volume, xy, xz and yz one after another."""
    sizes = [*config.rows(3), *(rows for _ in range(3) for rows in config.rows(2))]
    return torch.arange(len(sizes)).repeat_interleave(torch.tensor(sizes))
