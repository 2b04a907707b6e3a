"""Fine-tuning of a finished scene: anchor positions stay fixed, all other parameters are trained."""

import dataclasses

import torch
from torch import Tensor

from splatwire.anchors.voxels import voxel_indices
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.config import Milestones, TrainConfig
from splatwire.neural.training.fine_tuning_phase import MASK_LOGITS
from splatwire.neural.training.initial import camera_extent, check_visible, parameter_shapes
from splatwire.neural.training.presets import CAUSAL, HACPP
from splatwire.neural.training.schedule import fine_tuning_rates
from splatwire.neural.training.state import CONTEXT_NEGATIVE_SLOPE, GrowthStatistics, TrainState
from splatwire.types import AnchorScene, CausalCoding, HacppCoding, Mlp
from splatwire.types.scene import Scene

_MIN_SCALING = 1e-6
"""Minimum scaling in world units: a decoded scaling may be 0 or negative, but its logarithm is trained."""
_LATENT = 0.01
"""Initial magnitude of the latent values behind the grid's signs; about forty steps in one direction flip a sign."""


def model_of(scene: Scene) -> str | None:
    """Returns the name of an anchor scene's context model, or None for scenes without anchors."""
    if not isinstance(scene, AnchorScene):
        return None
    return CAUSAL if isinstance(scene.coding, CausalCoding) else HACPP


def fine_tuning_config(config: TrainConfig, scene: AnchorScene) -> TrainConfig:
    """Converts a configuration for a new scene to a configuration for fine-tuning a finished scene.

    Args:
        config: Configuration for a new scene; its length, loss weights and packet losses are kept.
        scene: The scene, which determines shapes and voxel size.
    """
    # The whole training is fine-tuning here, so it has the length of the main phase and no phase after it. The context
    # model initialises its networks in iteration `context_start + 1`: -1 keeps those of the finished scene.
    milestones = Milestones(
        config.milestones.main_iterations, noise_start=-1, growth_pause_end=-1, context_start=-1, statistics_start=0,
        growth_start=0, growth_end=0, growth_interval=1,
    )  # fmt: skip
    # Parameters are averaged over the last iterations only with the causal model. In 240 iterations of fine-tuning,
    # averaging improves lego with the causal model by 0.33 dB without packet loss. It makes the official
    # snowmiku_small_2400, which has the HAC++ model, 0.14 dB worse.
    averaging_iterations = config.averaging_iterations if isinstance(scene.coding, CausalCoding) else 0
    return dataclasses.replace(
        config,
        model=scene.coding.config,
        voxel_size=scene.coding.voxel_size,
        hidden=_widths(scene),
        milestones=milestones,
        rates=fine_tuning_rates(config.rates),
        averaging_iterations=averaging_iterations,
    )


def _widths(scene: AnchorScene) -> tuple[int, int, int]:
    """Returns the numbers of hidden units of a scene's networks, to create networks of the same sizes."""
    if isinstance(scene.coding, CausalCoding):
        context = 2 * [scene.coding.networks["position"]]
    else:
        context = [scene.coding.context_model.prior, scene.coding.context_model.channel[0]]
    head, prior, channel = (mlp.hidden.weight.shape[0] for mlp in (scene.heads.opacity, *context))
    return head, prior, channel


def state_of_scene(scene: AnchorScene, dataset: Dataset, config: TrainConfig) -> TrainState:
    """Returns the initial state for fine-tuning a finished scene.

    Args:
        scene: The complete scene, on the CPU.
        dataset: The training views.
        config: Result of `fine_tuning_config`.

    Raises:
        DatasetError: If more than half of the training views see no anchor of the scene.
        InvalidValueError: If this trainer does not support the scene's networks, or positions are not multiples of the
            voxel size.
    """
    scene = to_tensors(scene)
    anchors = scene.anchors
    absent, present = MASK_LOGITS
    logs = anchors.scalings.clamp(min=_MIN_SCALING).log()
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
    # A scene of other photos, or in other coordinates, would be trained to show nothing.
    in_scene = dataclasses.replace(dataset, cameras=dataset.cameras.relative_to(scene.origin), points=None)
    check_visible(in_scene, anchors.positions, "anchors of the scene")
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
        origin=scene.origin,
        photo_size=(dataset.cameras.width, dataset.cameras.height),
        metadata=scene.metadata,
    )


def _context_parameters(coding: HacppCoding | CausalCoding) -> dict[str, Tensor | Mlp]:
    """Returns the networks and tensors of the context model, keyed by parameter name."""
    if isinstance(coding, CausalCoding):
        networks = {f"causal.{name}": mlp for name, mlp in coding.networks.items()}
        return {**networks, "log_steps": coding.steps.log(), "zero_points": coding.zero_points}
    grid, channel = (
        coding.context_model.grid,
        {f"channel.{group}": mlp for group, mlp in enumerate(coding.context_model.channel)},
    )
    tables = {"grid.volume": grid.volume * _LATENT, "grid.planes": grid.planes * _LATENT}
    return {"prior": coding.context_model.prior, **channel, **tables}


def _bounds(coding: HacppCoding | CausalCoding) -> tuple[Tensor, Tensor]:
    """Returns the lower and upper bounds with which a scene's context model normalises anchor positions."""
    # The bounding box of the hash grid; with the causal model, the middle of the anchors minus and plus their
    # spread.
    if isinstance(coding, CausalCoding):
        return coding.middle - coding.spread, coding.middle + coding.spread
    return coding.context_model.grid.bounds_min, coding.context_model.grid.bounds_max


def _tensors(parameters: dict[str, Tensor | Mlp]) -> dict[str, Tensor]:
    """Returns all parameters as tensors; a network is represented by its weights and biases."""
    tensors: dict[str, Tensor] = {}
    for name, value in parameters.items():
        if isinstance(value, Tensor):
            tensors[name] = value
            continue
        if value.negative_slope != (CONTEXT_NEGATIVE_SLOPE if name.startswith(("channel.", "causal.")) else 0.0):
            raise InvalidValueError(f"network '{name}' of the scene has another activation than this trainer's")
        for layer in ("hidden", "output"):
            linear = getattr(value, layer)
            tensors |= {f"{name}.{layer}.weight": linear.weight, f"{name}.{layer}.bias": linear.bias}
    return tensors


def _check(tensors: dict[str, Tensor], shapes: dict[str, tuple[int, ...]]) -> None:
    for name, shape in shapes.items():
        if name not in tensors or tuple(tensors[name].shape) != shape:
            actual = tuple(tensors[name].shape) if name in tensors else "nothing"
            raise InvalidValueError(f"'{name}' of the scene is {actual}, this trainer has {shape}")
