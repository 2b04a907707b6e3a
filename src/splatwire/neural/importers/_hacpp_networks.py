"""Turns the state dictionaries of an HAC++ checkpoint into networks and a hash grid."""

import re
from collections.abc import Mapping

import torch
from torch import Tensor

from splatwire.types import HashGrid, HashGridConfig, Linear, Mlp

_LEAKY_SLOPE = 0.01
_MAX_LOG2_ROWS = 24


def two_layer_network(
    state: Mapping[str, Tensor],
    prefix: str,
    num_inputs: int,
    num_outputs: int,
    *,
    where: str,
    negative_slope: float = 0.0,
) -> Mlp:
    """Builds a two-layer network from the tensors `{prefix}0.weight|bias` and `{prefix}2.weight|bias`.

    Args:
        state: Tensors of the checkpoint by name.
        prefix: Prefix of the tensor names.
        num_inputs: Expected number of inputs.
        num_outputs: Expected number of outputs.
        where: Name of the network for error messages.
        negative_slope: Slope of the (leaky) ReLU for negative inputs.

    Raises:
        ValueError: If a tensor is missing or has the wrong shape.
    """
    names = [f"{prefix}{layer}.{part}" for layer in (0, 2) for part in ("weight", "bias")]
    for name in names:
        if name not in state:
            raise ValueError(f"'{where}' has no '{name}'")
    tensors = [state[name].detach().float() for name in names]
    hidden = tensors[1].numel()
    expected = [(hidden, num_inputs), (hidden,), (num_outputs, hidden), (num_outputs,)]
    for name, tensor, shape in zip(names, tensors, expected, strict=True):
        if tuple(tensor.shape) != shape:
            raise ValueError(f"'{where}' / '{name}' has shape {tuple(tensor.shape)}, expected {shape}")
    return Mlp(Linear(tensors[0], tensors[1]), Linear(tensors[2], tensors[3]), negative_slope)


def channel_networks(state: Mapping[str, Tensor]) -> tuple[tuple[Mlp, ...], tuple[int, ...]]:
    """Builds the networks that predict feature channels (HAC++'s channel context) from the tensors of a checkpoint.

    Each network predicts one group of channels from the previous groups and the output of the prior network.

    Returns:
        One network per feature group, and the number of channels of each group.

    Raises:
        ValueError: If the sizes of the networks are inconsistent.
    """
    # HAC++'s small variant has smaller networks without some of these inputs; they are extended with zero weights.
    count = len({match[1] for name in state if (match := re.match(r"MLP_d(\d+)\b", name))})
    if not count:
        raise ValueError("'deform_mlp' has no networks MLP_d0, MLP_d1, ...")
    free = "MLP_d0.0.weight" not in state
    first = [name for name in state if re.match(r"MLP_d0\b", name)]
    if free and (len(first) != 1 or state[first[0]].numel() % 3):
        raise ValueError(f"'deform_mlp': group 0 is neither a network nor one free parameter: {', '.join(first)}")
    sizes = [state[first[0]].numel() // 3] if free else []
    for group in range(len(sizes), count):
        name = f"MLP_d{group}.2.bias"
        if name not in state or state[name].numel() % 3 or not state[name].numel():
            raise ValueError(f"'deform_mlp' / '{name}' is missing or not a multiple of 3 long")
        sizes.append(state[name].numel() // 3)
    num_prior = 3 * sum(sizes)
    networks = [_free_parameters(state[first[0]], num_prior)] if free else []
    for group in range(len(networks), count):
        num_decoded = sum(sizes[:group])
        network = two_layer_network(
            state,
            f"MLP_d{group}.",
            num_decoded + (0 if free else num_prior),
            3 * sizes[group],
            where="deform_mlp",
            negative_slope=_LEAKY_SLOPE,
        )
        networks.append(_blind_to_prior(network, num_prior) if free else network)
    return tuple(networks), tuple(sizes)


def hash_grid(state: Mapping[str, Tensor], bounds_min: Tensor, bounds_max: Tensor) -> tuple[HashGrid, HashGridConfig]:
    """Builds the binary hash grid from the signs of the checkpoint's parameters.

    Raises:
        ValueError: If a table is missing, or its number of rows does not fit its resolutions.
    """
    volume, resolutions_3d, log2_3d = _table(state, "encoding_xyz", 3)
    planes, shapes = [], set()
    for plane in ("encoding_xy", "encoding_xz", "encoding_yz"):
        signs, resolutions, log2_rows = _table(state, plane, 2)
        planes.append(signs)
        shapes.add((signs.shape, resolutions, log2_rows))
    if len(shapes) != 1 or planes[0].shape[1] != volume.shape[1]:
        raise ValueError("'encoding_xyz': the tables of the hash grid differ in resolutions or features")
    _, resolutions_2d, log2_2d = next(iter(shapes))
    config = HashGridConfig(int(volume.shape[1]), resolutions_3d, resolutions_2d, log2_3d, log2_2d)
    return HashGrid(volume, torch.stack(planes), bounds_min, bounds_max), config


def _table(state: Mapping[str, Tensor], name: str, dims: int) -> tuple[Tensor, tuple[int, ...], int]:
    parts = [state.get(f"{name}.{part}") for part in ("params", "resolutions_list", "offsets_list")]
    if any(part is None for part in parts):
        raise ValueError(f"'encoding_xyz' has no complete table '{name}'")
    params, resolution_list, offset_list = (part for part in parts if part is not None)
    resolutions = tuple(int(r) for r in resolution_list.flatten())
    rows = tuple(int(n) for n in offset_list.flatten().diff())
    if params.dim() != 2 or not resolutions or min(resolutions) < 2:
        raise ValueError(f"'{name}' has shape {tuple(params.shape)} and resolutions {resolutions}")
    for log2_rows in range(1, _MAX_LOG2_ROWS + 1):
        expected = HashGridConfig(1, resolutions, resolutions, log2_rows, log2_rows).rows(dims)
        if expected == rows:
            break
    else:
        raise ValueError(f"'{name}' has levels of {rows} rows, which no table size gives")
    if params.shape[0] != sum(rows):
        raise ValueError(f"'{name}' has {params.shape[0]} rows, its levels {sum(rows)}")
    signs = torch.where(params.detach() >= 0, 1, -1).to(torch.int8)
    return signs, resolutions, log2_rows


def _free_parameters(values: Tensor, num_prior: int) -> Mlp:
    """Builds a network whose outputs are constants: trained parameters that do not depend on the inputs.

    The small variant of HAC++ has such parameters in place of the network for the first feature group.

    Args:
        values: The constants, as tensor of any shape.
        num_prior: Number of inputs, which have no effect.
    """
    bias = values.detach().float().flatten()
    nothing = Linear(torch.zeros(1, num_prior), torch.zeros(1))
    return Mlp(nothing, Linear(torch.zeros(len(bias), 1), bias), _LEAKY_SLOPE)


def _blind_to_prior(network: Mlp, num_prior: int) -> Mlp:
    weight = network.hidden.weight
    padded = torch.cat([weight, weight.new_zeros(weight.shape[0], num_prior)], dim=1)
    return Mlp(Linear(padded, network.hidden.bias), network.output, network.negative_slope)
