"""A finished scene goes on learning: its anchors stay where they are, everything else is the second half of a run."""

import dataclasses

import torch
from torch import Tensor

from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, CausalCoding, HacppCoding, Mlp
from splatwire.model.scene import Scene
from splatwire.model.tensors import to_tensors
from splatwire.model.voxels import voxel_indices
from splatwire.train.config import Marks, TrainConfig
from splatwire.train.initial import camera_extent, parameter_shapes
from splatwire.train.presets import CAUSAL, HACPP
from splatwire.train.schedule import second_half
from splatwire.train.state import CHANNEL_SLOPE, GrowthStatistics, TrainState
from splatwire.train.tuning import MASK_LOGITS

_SMALLEST_SCALING = 1e-6
"""World units; a decoded scaling may be 0 or less, and its logarithm is learnt."""
_LATENT = 0.01
"""Numbers behind the grid's signs: some forty steps that agree turn one."""


def model_of(scene: Scene) -> str | None:
    """The model that a scene goes on with; None if it is no scene of anchors."""
    if not isinstance(scene, AnchorScene):
        return None
    return CAUSAL if isinstance(scene.coding, CausalCoding) else HACPP


def fine_tuning(config: TrainConfig, scene: AnchorScene) -> TrainConfig:
    """Returns the recipe with which a finished scene goes on: nothing grows, rates are of a published second half.

    Of the mean of late iterations (`train.averaging`), lego of the causal model is 0.33 dB better, without loss; the
    official snowmiku_small_2400 is 0.14 dB worse, so scenes of format 1 go without (240 iterations each).

    Args:
        config: The recipe of a new scene; its length, weights and losses stay.
        scene: The scene, which brings its shapes and voxels.
    """
    iterations, widths = config.marks.settled, _widths(scene)
    marks = Marks(
        iterations, noise_start=-1, growth_pause_end=-1, context_start=-1, statistics_start=0, growth_start=0,
        growth_end=0, growth_interval=1,
    )  # fmt: skip
    return dataclasses.replace(
        config,
        model=scene.coding.config,
        voxel_size=scene.coding.voxel_size,
        hidden=widths,
        marks=marks,
        rates=second_half(config.rates),
        averaged=config.averaged if isinstance(scene.coding, CausalCoding) else 0,
    )


def _widths(scene: AnchorScene) -> tuple[int, int, int]:
    """Hidden units as in `TrainConfig.hidden`."""
    if isinstance(scene.coding, CausalCoding):
        context = 2 * [scene.coding.networks["position"]]
    else:
        context = [scene.coding.context.prior, scene.coding.context.channel[0]]
    head, prior, channel = (mlp.hidden.weight.shape[0] for mlp in (scene.heads.opacity, *context))
    return head, prior, channel


def state_of_scene(scene: AnchorScene, dataset: Dataset, config: TrainConfig) -> TrainState:
    """Returns the state in which a finished scene goes on learning.

    Args:
        scene: The scene, complete, on the CPU.
        dataset: The training views.
        config: What `fine_tuning` returned.

    Raises:
        InvalidValueError: If the scene's networks are not those of this trainer, or positions are not whole voxels.
    """
    scene = to_tensors(scene)
    anchors = scene.anchors
    absent, present = MASK_LOGITS
    logs = anchors.scalings.clamp(min=_SMALLEST_SCALING).log()
    parameters = {
        "features": anchors.features,
        "log_scalings": logs[:, [0, 3, 4, 5]] if isinstance(scene.coding, CausalCoding) else logs,
        "offsets": anchors.offsets,
        "mask_logits": torch.where(anchors.mask, present, absent),
        **{f"heads.{name}": mlp for name, mlp in vars(scene.heads).items()},
        **_context_parameters(scene.coding),
    }
    bounds_min, bounds_max = _bounds(scene.coding)
    tensors = _tensors(parameters)
    _check(tensors, parameter_shapes(config, anchors.num_anchors))
    return TrainState(
        iteration=0,
        voxels=torch.from_numpy(voxel_indices(anchors.positions, scene.coding.voxel_size)),
        voxel_size=scene.coding.voxel_size,
        parameters={name: value.float().clone().contiguous().requires_grad_() for name, value in tensors.items()},
        moments={},
        statistics=GrowthStatistics.zeros(anchors.num_anchors, anchors.mask.shape[1], torch.device("cpu")),
        bounds_min=bounds_min,
        bounds_max=bounds_max,
        camera_extent=camera_extent(dataset.cameras),
        generator=torch.Generator().manual_seed(config.seed),
    )


def _context_parameters(coding: HacppCoding | CausalCoding) -> dict[str, Tensor | Mlp]:
    """What predicts anchors, by the names of parameters."""
    if isinstance(coding, CausalCoding):
        networks = {f"causal.{name}": mlp for name, mlp in coding.networks.items()}
        return {**networks, "steps": coding.steps.log(), "centres": coding.centres}
    grid, channel = coding.context.grid, {f"channel.{group}": mlp for group, mlp in enumerate(coding.context.channel)}
    planes = {"grid.volume": grid.volume * _LATENT, "grid.planes": grid.planes * _LATENT}
    return {"prior": coding.context.prior, **channel, **planes}


def _bounds(coding: HacppCoding | CausalCoding) -> tuple[Tensor, Tensor]:
    """The state's bounds: of the hash grid, or of what the causal model takes for the middle of the scene."""
    if isinstance(coding, CausalCoding):
        return coding.middle - coding.spread, coding.middle + coding.spread
    return coding.context.grid.bounds_min, coding.context.grid.bounds_max


def _tensors(parameters: dict[str, Tensor | Mlp]) -> dict[str, Tensor]:
    """Replaces networks by their weights and biases."""
    found: dict[str, Tensor] = {}
    for name, value in parameters.items():
        if isinstance(value, Tensor):
            found[name] = value
            continue
        if value.negative_slope != (CHANNEL_SLOPE if name.startswith(("channel.", "causal.")) else 0.0):
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
