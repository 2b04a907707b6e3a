"""Conversion of the state of a training to a scene that can be rendered, saved and encoded."""

import torch
from torch import Tensor

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.neural.training.averaging import with_averaged_parameters
from splatwire.neural.training.causal import causal_networks
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.grid import hard_sign
from splatwire.neural.training.state import TrainState, move_state
from splatwire.ops.arrays import to_arrays
from splatwire.types import (
    Anchors,
    AnchorScene,
    GaussianHeads,
    HacppCoding,
    HacppConfig,
    HacppContextModel,
    HashGrid,
    Linear,
    Mlp,
)
from splatwire.types.causal_coding import CausalCoding, CausalConfig


@checked
@torch.no_grad()
def export_scene(state: TrainState, config: TrainConfig, device: torch.device | None = None) -> AnchorScene:
    """Returns the scene of a training state, with averaged parameters if available; omits anchors without offsets.

    Args:
        state: State of the training; not changed.
        config: The configuration.
        device: Device for the computation; None for the CPU.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    state = with_averaged_parameters(move_state(state, device or torch.device("cpu")))
    parameters, networks, mask = state.parameters, state.networks, state.masks(config.mask_threshold)
    kept = mask.any(dim=1)
    if not bool(kept.any()):
        raise InvalidValueError("training has left no anchor in the scene: lambda is too large for it")
    anchors = Anchors(
        positions=state.positions[kept],
        features=parameters["features"][kept],
        scalings=state.scalings(kept),
        offsets=parameters["offsets"][kept] * mask[kept][:, :, None],
        mask=mask[kept],
    )
    heads = GaussianHeads(*(copied_mlp(mlp) for mlp in vars(networks.heads).values()))
    coding = _causal(state, config.causal) if isinstance(config.model, CausalConfig) else _hacpp(state, config.hacpp)
    return to_arrays(
        AnchorScene(anchors, heads, coding, background=config.background, origin=state.origin, metadata=state.metadata)
    )


def _causal(state: TrainState, model_config: CausalConfig) -> CausalCoding:
    networks = {name: copied_mlp(mlp) for name, mlp in causal_networks(state.parameters, model_config).items()}
    return CausalCoding(
        networks, state.parameters["log_steps"].exp(), state.parameters["zero_points"].clone(),
        (state.bounds_max + state.bounds_min) / 2, (state.bounds_max - state.bounds_min) / 2,
        state.voxel_size, model_config,
    )  # fmt: skip


def _hacpp(state: TrainState, model_config: HacppConfig) -> HacppCoding:
    parameters, networks = state.parameters, state.networks
    grid = HashGrid(
        volume=_signs(parameters["grid.volume"]),
        planes=_signs(parameters["grid.planes"]),
        bounds_min=state.bounds_min,
        bounds_max=state.bounds_max,
    )
    channel = tuple(copied_mlp(mlp) for mlp in networks.channel)
    context = HacppContextModel(grid, copied_mlp(networks.context_prior), channel)
    return HacppCoding(context, state.voxel_size, model_config)


def _signs(values: Tensor) -> Tensor:
    return hard_sign(values).to(torch.int8)


@torch.no_grad()
def copied_mlp(mlp: Mlp) -> Mlp:
    """Returns a copy of a network."""
    # A snapshot of the scene must not change when the training continues.
    hidden, output = (Linear(layer.weight.clone(), layer.bias.clone()) for layer in (mlp.hidden, mlp.output))
    return Mlp(hidden, output, mlp.negative_slope)
