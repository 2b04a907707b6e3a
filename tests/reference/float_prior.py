"""Hash grid, prior and channel context of HAC++ in plain torch floats: reference of the integers of the codec."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import embedding_bag

from splatwire.neural.model.hash_grid import corner_rows, unit_coordinates
from splatwire.neural.model.prior_field import PriorOutputs, split_prior_outputs
from splatwire.neural.model.tensors import run_network
from splatwire.types.anchor_config import PLANES, HacppConfig, HashGridConfig
from splatwire.types.anchor_scene import HacppContextModel, HashGrid
from splatwire.types.prior import MIN_SCALE, AttributePrior, Prior

_CHUNK = 32768


@torch.no_grad()
def interpolate_hash_grid(
    grid: HashGrid, positions: Float[Tensor, "N 3"], config: HashGridConfig
) -> Float[Tensor, "N H"]:
    """Returns the hash-grid features at anchor positions: interpolated signs of the grid's tables (HAC++, hash grid).

    Args:
        grid: The tables and their bounding box.
        positions: World coordinates; processed in chunks to limit memory.
        config: Resolutions and table sizes of the hash grid.

    Returns:
        The features of all levels of the 3D table, then those of the planes xy, xz and yz; zero for positions outside
        the box.
    """
    dtype = positions.dtype
    volume, planes = grid.volume.to(dtype), grid.planes.to(dtype)
    out = positions.new_empty(len(positions), config.context_dim)
    for start in range(0, len(positions), _CHUNK):
        unit = unit_coordinates(grid, positions[start : start + _CHUNK])
        out[start : start + _CHUNK] = interpolate_tables(volume, planes, unit, config)
    return out


def interpolate_tables(
    volume: Float[Tensor, "rows3 D"],
    planes: Float[Tensor, "3 rows2 D"],
    unit: Float[Tensor, "N 3"],
    config: HashGridConfig,
) -> Float[Tensor, "N H"]:
    """Interpolates the real values of hash-grid tables at positions; differentiable in the tables.

    Args:
        volume: The 3D table, all levels.
        planes: The tables of the three planes, all levels.
        unit: Positions in coordinates of the bounding box, [0, 1] per axis inside the box.
        config: Resolutions and table sizes of the hash grid.
    """
    features = [_interpolate_levels(volume, unit, config.resolutions_3d, config.rows(3))]
    for table, axes in zip(planes, PLANES, strict=True):
        features.append(_interpolate_levels(table, unit[:, axes], config.resolutions_2d, config.rows(2)))
    return torch.cat(features, dim=1)


def _interpolate_levels(
    table: Float[Tensor, "rows D"],
    unit: Float[Tensor, "N dims"],
    resolutions: Sequence[int],
    rows_per_level: Sequence[int],
) -> Float[Tensor, "N _"]:
    levels = []
    start = 0
    for resolution, num_rows in zip(resolutions, rows_per_level, strict=True):
        rows, weights = corner_rows(unit, resolution, num_rows)
        level = table[start : start + num_rows]
        levels.append(embedding_bag(rows, level, mode="sum", per_sample_weights=weights))
        start += num_rows
    return torch.cat(levels, dim=1)


def prior_of(outputs: PriorOutputs, context: Float[Tensor, "N H"], config: HacppConfig) -> Prior:
    """Converts outputs of the prior network to distributions and quantisation steps of attributes; differentiable.

    A quantisation step is `base * (1 + tanh(logit))`.

    Args:
        outputs: Outputs of the prior network.
        context: The interpolated hash-grid feature of each anchor, which is the network's input.
        config: Shapes and base quantisation steps.
    """
    base = outputs.step_logits.new_tensor(config.base_steps)
    steps = base * (1 + torch.tanh(outputs.step_logits))
    return Prior(
        feature=AttributePrior(outputs.feature_mean, outputs.feature_scale.clamp(min=MIN_SCALE), steps[:, 0:1]),
        scaling=AttributePrior(outputs.scaling_mean, outputs.scaling_scale.clamp(min=MIN_SCALE), steps[:, 1:2]),
        offset=AttributePrior(outputs.offset_mean, outputs.offset_scale.clamp(min=MIN_SCALE), steps[:, 2:3]),
        context_features=context,
    )


@torch.no_grad()
def evaluate_prior(context: HacppContextModel, positions: Float[Tensor, "N 3"], config: HacppConfig) -> Prior:
    """Predicts the distributions and quantisation steps of the attributes of anchors from their positions.

    Args:
        context: Context model, with the hash grid and the prior network.
        positions: World coordinates of the anchors; processed in chunks to limit memory.
        config: Shapes and base quantisation steps.
    """
    feature = interpolate_hash_grid(context.grid, positions, config.grid)
    outputs = positions.new_empty(len(positions), config.prior_dim)
    for start in range(0, len(positions), _CHUNK):
        outputs[start : start + _CHUNK] = run_network(context.prior, feature[start : start + _CHUNK])
    return prior_of(split_prior_outputs(outputs, config), feature, config)


@dataclass(frozen=True, eq=False)
class ChannelParameters:
    """Second Gaussian of the mixture that models each channel of one feature group; the first is the prior's.

    Attributes:
        mean: Mean of each channel.
        scale: Standard deviation of each channel, positive.
        weight: Logit of the weight of this Gaussian; the mixture weights are the softmax of the prior's logit and this
            logit.
    """

    mean: Float[Tensor, "N C"]
    scale: Float[Tensor, "N C"]
    weight: Float[Tensor, "N C"]


def channel_parameters(
    context: HacppContextModel, group: int, decoded_features: Float[Tensor, "N D"], outputs: PriorOutputs
) -> ChannelParameters:
    """Predicts the distribution of the channels of feature group `group`; differentiable.

    Args:
        context: Context model with the channel networks.
        group: Index of the feature group.
        decoded_features: The decoded channels of all previous groups (no columns for group 0).
        outputs: Outputs of the prior network for the same anchors.

    Raises:
        ValueError: If `decoded_features` has another number of channels than the previous groups.
    """
    network = context.channel[group]
    inputs = [decoded_features, outputs.feature_mean, outputs.feature_scale, outputs.feature_weight]
    expected = network.hidden.weight.shape[1] - 3 * outputs.feature_mean.shape[1]
    if decoded_features.shape[1] != expected:
        raise ValueError(f"group {group} follows {expected} channels, not {decoded_features.shape[1]}")
    mean, scale, weight = run_network(network, torch.cat(inputs, dim=1)).chunk(3, dim=1)
    return ChannelParameters(mean, scale.clamp(min=MIN_SCALE), weight)
