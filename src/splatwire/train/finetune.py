"""A finished scene goes on learning: its anchors stay where they are, everything else is the second half of a run."""

import dataclasses
import math

import torch
from torch import Tensor

from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, Mlp
from splatwire.model.voxels import voxel_indices
from splatwire.train.config import LearningRate, LearningRates, Marks, TrainConfig
from splatwire.train.initial import camera_extent, parameter_shapes
from splatwire.train.state import CHANNEL_SLOPE, GrowthStatistics, TrainState

_SMALLEST_SCALING = 1e-6
"""World units; a decoded scaling may be 0 or less, and its logarithm is learnt."""
_LATENT = 0.01
"""Numbers behind the grid's signs: some forty steps that agree turn one."""
_MASK_LOGITS = (-8.0, 0.0)
"""Of offsets that do not exist and that do."""


def fine_tuning(config: TrainConfig, scene: AnchorScene) -> TrainConfig:
    """Returns the recipe with which a finished scene goes on: nothing grows, rates are those of a second half.

    Args:
        config: The recipe of a new scene; its length, weights and losses stay.
        scene: The scene, which brings its shapes and voxels.
    """
    model, iterations = scene.coding.context, config.marks.iterations
    widths = [mlp.hidden.weight.shape[0] for mlp in (scene.heads.opacity, model.prior, model.channel[0])]
    marks = Marks(
        iterations, noise_start=-1, growth_pause_end=-1, context_start=-1, statistics_start=0, growth_start=0,
        growth_end=0, growth_interval=1,
    )  # fmt: skip
    rates = {
        name: LearningRate(math.sqrt(rate.initial * rate.final), rate.final)
        for name, rate in vars(config.rates).items()
    }
    return dataclasses.replace(
        config,
        model=scene.coding.config,
        voxel_size=scene.coding.voxel_size,
        hidden=(widths[0], widths[1], widths[2]),
        marks=marks,
        rates=LearningRates(**rates),
    )


def state_of_scene(scene: AnchorScene, dataset: Dataset, config: TrainConfig) -> TrainState:
    """Returns the state in which a finished scene goes on learning.

    Args:
        scene: The scene, complete, on the CPU.
        dataset: The training views.
        config: What `fine_tuning` returned.

    Raises:
        InvalidValueError: If the scene's networks are not those of this trainer, or positions are not whole voxels.
    """
    anchors, context = scene.anchors, scene.coding.context
    absent, present = _MASK_LOGITS
    parameters = {
        "features": anchors.features,
        "log_scalings": anchors.scalings.clamp(min=_SMALLEST_SCALING).log(),
        "offsets": anchors.offsets,
        "mask_logits": torch.where(anchors.mask, present, absent),
        **{f"heads.{name}": mlp for name, mlp in vars(scene.heads).items()},
        "prior": context.prior,
        **{f"channel.{group}": mlp for group, mlp in enumerate(context.channel)},
        "grid.volume": context.grid.volume * _LATENT,
        "grid.planes": context.grid.planes * _LATENT,
    }
    tensors = _tensors(parameters)
    _check(tensors, parameter_shapes(config, anchors.num_anchors))
    return TrainState(
        iteration=0,
        voxels=voxel_indices(anchors.positions, scene.coding.voxel_size),
        voxel_size=scene.coding.voxel_size,
        parameters={name: value.float().clone().contiguous().requires_grad_() for name, value in tensors.items()},
        moments={},
        statistics=GrowthStatistics.zeros(anchors.num_anchors, anchors.mask.shape[1], torch.device("cpu")),
        bounds_min=context.grid.bounds_min,
        bounds_max=context.grid.bounds_max,
        camera_extent=camera_extent(dataset.cameras),
        generator=torch.Generator().manual_seed(config.seed),
    )


def _tensors(parameters: dict[str, Tensor | Mlp]) -> dict[str, Tensor]:
    """Replaces networks by their weights and biases."""
    found: dict[str, Tensor] = {}
    for name, value in parameters.items():
        if isinstance(value, Tensor):
            found[name] = value
            continue
        if value.negative_slope != (CHANNEL_SLOPE if name.startswith("channel.") else 0.0):
            raise InvalidValueError(f"network '{name}' of the scene has another activation than this trainer's")
        for layer in ("hidden", "output"):
            linear = getattr(value, layer)
            found |= {f"{name}.{layer}.weight": linear.weight, f"{name}.{layer}.bias": linear.bias}
    return found


def _check(tensors: dict[str, Tensor], shapes: dict[str, tuple[int, ...]]) -> None:
    for name, shape in shapes.items():
        if name not in tensors or tuple(tensors[name].shape) != shape:
            found = tuple(tensors[name].shape) if name in tensors else "nothing"
            raise InvalidValueError(f"'{name}' of the scene is {found}, this trainer has {shape}")
