"""Conversion of numpy arrays in nested dataclasses to torch tensors, and loading of tensors into networks."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatwire.errors import BitstreamError
from splatwire.ops.arrays import map_items
from splatwire.types.networks import Mlp


def to_tensors(value: Any, device: torch.device | str | None = None) -> Any:
    """Replaces numpy arrays by torch tensors.

    Args:
        value: An array or tensor, or a tuple, dictionary or dataclass with arrays or tensors at any depth.
        device: Torch device of the result; None keeps tensors on their current device.
    """
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            return value
        tensor = torch.from_numpy(value if value.flags.writeable else value.copy())
        return tensor if device is None else tensor.to(device)
    if isinstance(value, Tensor):
        return value if device is None else value.to(device)
    return map_items(value, lambda part: to_tensors(part, device))


def run_network(network: Mlp, x: Float[Tensor, "N in"]) -> Float[Tensor, "N out"]:
    """Returns the outputs of a two-layer network for a batch of inputs; differentiable."""
    h = functional.linear(x, network.hidden.weight, network.hidden.bias)
    h = functional.leaky_relu(h, network.negative_slope) if network.negative_slope else functional.relu(h)
    return functional.linear(h, network.output.weight, network.output.bias)


def load_tensors(network: torch.nn.Module, tensors: dict[str, Tensor], prefix: str) -> None:
    """Copies tensors into the parameters and buffers of a network.

    Args:
        network: The network; changed in place.
        tensors: All tensors of the network by name.
        prefix: Prefix of error messages, such as the path of the file.

    Raises:
        BitstreamError: If a tensor is missing, unknown, of another shape, or not finite.
    """
    check_tensors(network, tensors, prefix)
    network.load_state_dict({name: value.float() for name, value in tensors.items()})


def check_tensors(network: torch.nn.Module, tensors: dict[str, Tensor], prefix: str) -> None:
    """Checks that tensors have the names and shapes of a network's parameters and buffers, and finite values.

    Raises:
        BitstreamError: If a tensor is missing, unknown, of another shape, or not finite.
    """
    wanted = network.state_dict()
    if set(tensors) != set(wanted):
        odd = sorted(set(tensors) ^ set(wanted))
        raise BitstreamError(f"{prefix}tensors of the network are missing or unknown: {', '.join(odd[:3])}")
    for name, value in wanted.items():
        tensor = tensors[name]
        if tensor.shape != value.shape or not tensor.dtype.is_floating_point:
            raise BitstreamError(f"{prefix}'{name}' is {tensor.dtype} {tuple(tensor.shape)}, not {tuple(value.shape)}")
        if not bool(tensor.isfinite().all()):
            raise BitstreamError(f"{prefix}'{name}' of the network is not finite")
