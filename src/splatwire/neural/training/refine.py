"""Refines the context model of a finished scene, so that the same attributes take fewer bits.

HAC++ model (causal model: `refine_causal`): the attributes are fixed, and no picture is rendered.
"""

# During training, the attributes change in every iteration, and the rate is estimated from a twentieth of the anchors.
# Here the networks converge within a minute. The loss is the bits of all attributes under the coder's distributions
# (HAC++, rate), plus the bits of the hash grid's signs. The rendered scene hardly changes, because quantisation steps
# hardly change.

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.model.hash_grid import unit_coordinates
from splatwire.neural.model.prior_field import PriorOutputs, split_prior_outputs, typical_spread
from splatwire.neural.model.tensors import run_network, to_tensors
from splatwire.neural.training.config import RefineConfig
from splatwire.neural.training.export import copied_mlp
from splatwire.neural.training.fit import fit_samples
from splatwire.neural.training.grid import (
    GridCorners,
    find_corners,
    hard_sign,
    interpolate_signs,
    straight_through_sign,
)
from splatwire.neural.training.hacpp import AttributeBits, adaptive_steps, attribute_bits
from splatwire.neural.training.refine_causal import refine_causal
from splatwire.ops.arrays import to_arrays
from splatwire.types import (
    Anchors,
    AnchorScene,
    CausalCoding,
    HacppConfig,
    HacppContextModel,
    HashGrid,
    HashGridConfig,
    Linear,
    Mlp,
)

_CHUNK = 8192
_STEP_SCALE = 0.2
"""Scale of the network outputs for logits of quantisation steps, so that one learning rate suits all outputs.

Other outputs are scaled by the predicted standard deviation.
"""


@dataclass(frozen=True, eq=False)
class _ConstantData:
    """Data of a scene that is constant during the refinement of its context model.

    Attributes:
        config: Shapes of the model.
        corners: Table rows and weights of the hash grid at the anchors.
        logits: Outputs of the prior network from which the quantisation steps were computed before the refinement.
        steps: The quantisation steps.
        values: Features, scalings and offsets, rounded to their steps.
        mask: Mask of the offsets that exist, 0 or 1.
    """

    config: HacppConfig
    corners: GridCorners
    logits: Float[Tensor, "N 3"]
    steps: Float[Tensor, "N 3"]
    values: tuple[Tensor, Tensor, Tensor]
    mask: Float[Tensor, "N K"]


class _ScaledMlp:
    """Trainable network whose outputs are divided by typical values, so that one learning rate suits all outputs.

    Args:
        mlp: The initial network.
        unit: Typical value of each output.
    """

    def __init__(self, mlp: Mlp, unit: Float[Tensor, "out"]) -> None:
        self._slope, self._unit = mlp.negative_slope, unit
        hidden, output = mlp.hidden, mlp.output
        start = (hidden.weight, hidden.bias, output.weight / unit[:, None], output.bias / unit)
        self.parameters = [tensor.detach().clone().requires_grad_() for tensor in start]

    def mlp(self) -> Mlp:
        """Returns the trained network. Its outputs are multiplied by `unit`, as those of the initial network are.

        The result is differentiable with respect to the trained parameters.
        """
        weight, bias, output, output_bias = self.parameters
        return Mlp(Linear(weight, bias), Linear(output * self._unit[:, None], output_bias * self._unit), self._slope)


class _BinaryGrid:
    """Hash grid in training, whose entries are the signs (+1 or -1) of real numbers."""

    def __init__(self, grid: HashGrid, config: HashGridConfig, corners: GridCorners, latent: float) -> None:
        self.volume = (grid.volume.float() * latent).requires_grad_()
        self.planes = (grid.planes.float() * latent).requires_grad_()
        self._level = _level_of_row(config)
        self._read = torch.zeros(len(self._level))
        self._read[torch.cat([corners.volume_rows.flatten(), corners.plane_rows.flatten()]).long()] = 1

    def bits(self) -> Float[Tensor, ""]:
        """Estimates the size of the grid's signs in the stream in bits; differentiable."""
        # The estimate is the ideal code length if the coder knows the share of +1 in each level and feature
        # channel. Signs that no anchor reads are not counted.
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
        """Returns the refined hash grid: the signs of the trained table entries, with the bounding box of `grid`.

        Args:
            grid: The hash grid before the refinement.
        """
        volume, planes = (hard_sign(table.detach()).to(torch.int8) for table in (self.volume, self.planes))
        return HashGrid(volume, planes, grid.bounds_min, grid.bounds_max)


def refine_context(
    scene: AnchorScene, config: RefineConfig | None = None, *, progress: Callable[[float], None] = lambda share: None
) -> AnchorScene:
    """Refines the context model of a finished scene so that the same attributes take fewer bits.

    Anchors and rendering networks do not change; quantisation steps hardly change.

    Args:
        scene: The scene, on the CPU.
        config: Number of Adam steps, learning rates and weights; None for the defaults.
        progress: Called with the completed share, 0 to 1.

    Returns:
        The scene with the refined context model; `scene` itself if there are no Adam steps or no anchors.

    Raises:
        DivergedError: If the loss is not finite.
    """
    config, original = config or RefineConfig(), scene
    if isinstance(scene.coding, CausalCoding):
        return refine_causal(scene, config, progress=progress)
    scene = to_tensors(scene)
    alive = scene.anchors.mask.any(dim=1).nonzero()[:, 0]
    if not config.steps or not len(alive):
        return original
    fixed, outputs = _constant_data(scene, scene.anchors.select(alive))
    units = _typical_outputs(outputs, scene.hacpp.config)
    prior = _ScaledMlp(scene.hacpp.context_model.prior, units[0])
    channels = [_ScaledMlp(mlp, unit) for mlp, unit in zip(scene.hacpp.context_model.channel, units[1:], strict=True)]
    signs = _BinaryGrid(scene.hacpp.context_model.grid, scene.hacpp.config.grid, fixed.corners, config.latent)
    networks = [tensor for part in (prior, *channels) for tensor in part.parameters]
    fit_samples(
        [(networks, config.network_rate), ([signs.volume, signs.planes], config.grid_rate)], len(alive), config,
        lambda index, _: _loss(fixed, prior, channels, signs, index, config), progress,
    )  # fmt: skip
    context = HacppContextModel(
        signs.grid(scene.hacpp.context_model.grid),
        copied_mlp(prior.mlp()),
        tuple(copied_mlp(part.mlp()) for part in channels),
    )
    return dataclasses.replace(original, coding=dataclasses.replace(original.hacpp, context_model=to_arrays(context)))


def _loss(
    fixed: _ConstantData,
    prior: _ScaledMlp,
    channels: list[_ScaledMlp],
    signs: _BinaryGrid,
    index: Int64[Tensor, "M"],
    config: RefineConfig,
) -> Float[Tensor, ""]:
    """Returns the loss of the refinement: bits per anchor, plus a penalty on changed quantisation steps.

    Args:
        fixed: Data of the scene that does not change.
        prior: The prior network in training.
        channels: The channel networks in training.
        signs: The hash grid in training, whose entries are signs.
        index: Indices of the sampled anchors.
        config: Weights of the penalty and of the grid's bits.
    """
    # The penalty is needed because the fixed anchors were rounded with the previous steps.
    outputs = split_prior_outputs(
        run_network(prior.mlp(), interpolate_signs(signs.volume, signs.planes, fixed.corners, index)), fixed.config
    )
    layout = fixed.config.layout
    bits = attribute_bits(
        outputs, tuple(part.mlp() for part in channels), layout.feature_groups, fixed.steps[index],
        (fixed.values[0][index], fixed.values[1][index], fixed.values[2][index]),
    )  # fmt: skip
    moved = (outputs.step_logits - fixed.logits[index]).square().sum()
    loss_per_anchor = (_existing_bits(bits, fixed.mask[index]) + config.step_weight * moved) / len(index)
    return loss_per_anchor + config.grid_weight * signs.bits() / len(fixed.logits)


def _existing_bits(bits: AttributeBits, mask: Float[Tensor, "M K"]) -> Float[Tensor, ""]:
    offsets = bits.offsets.view(len(mask), mask.shape[1], 3).sum(dim=2)
    return bits.features.sum() + bits.scalings.sum() + (offsets * mask).sum()


@torch.no_grad()
def _constant_data(scene: AnchorScene, anchors: Anchors) -> tuple[_ConstantData, PriorOutputs]:
    """Computes the data that stays constant while hash grid and networks of a scene are refined.

    It also computes the outputs of the prior network before the refinement.

    Args:
        scene: The scene.
        anchors: Anchors to use.
    """
    corners = find_corners(unit_coordinates(scene.hacpp.context_model.grid, anchors.positions), scene.hacpp.config.grid)
    volume, planes = scene.hacpp.context_model.grid.volume.float(), scene.hacpp.context_model.grid.planes.float()
    parts = [
        run_network(scene.hacpp.context_model.prior, interpolate_signs(volume, planes, corners, index))
        for index in torch.arange(anchors.num_anchors).split(_CHUNK)
    ]
    outputs = split_prior_outputs(torch.cat(parts), scene.hacpp.config)
    steps = adaptive_steps(outputs.step_logits, scene.hacpp.config)
    values = (anchors.features, anchors.scalings, anchors.offsets.flatten(1))
    features, scalings, offsets = (
        (value / step).round() * step for value, step in zip(values, steps.split(1, dim=1), strict=True)
    )
    fixed = _ConstantData(
        scene.hacpp.config, corners, outputs.step_logits, steps, (features, scalings, offsets), anchors.mask.float()
    )
    return fixed, outputs


def _typical_outputs(outputs: PriorOutputs, config: HacppConfig) -> list[Float[Tensor, "out"]]:
    """Returns typical magnitudes of the outputs of the prior network and the channel networks, for normalisation."""
    # It is the typical predicted standard deviation of the attribute channel. Outputs are divided by it so that one
    # learning rate suits all.
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
    """Returns the grid level of each row of the concatenated hash-grid tables."""
    # Order: the 3D table, then planes xy, xz, yz.
    sizes = [*config.rows(3), *(rows for _ in range(3) for rows in config.rows(2))]
    return torch.arange(len(sizes)).repeat_interleave(torch.tensor(sizes))
