"""Records of the core as torch tensors for the neural part; `splatwire.ops.arrays.to_arrays` is the way back."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatwire.errors import BitstreamError
from splatwire.ops.arrays import mapped


def to_tensors(value: Any, device: torch.device | str | None = None) -> Any:
    """Returns the same record with torch tensors in place of numpy arrays.

    Args:
        value: An array or tensor, or a tuple, dictionary or dataclass of them at any depth; anything else is returned
            as it is.
        device: Where the tensors are moved to; None leaves each where it is.
    """
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            return value
        tensor = torch.from_numpy(value if value.flags.writeable else value.copy())
        return tensor if device is None else tensor.to(device)
    if isinstance(value, Tensor):
        return value if device is None else value.to(device)
    return mapped(value, lambda part: to_tensors(part, device))


def load_tensors(network: torch.nn.Module, tensors: dict[str, Tensor], where: str) -> None:
    """Puts tensors into a network, strictly.

    Raises:
        BitstreamError: If one is missing, too many, of another size, or not finite.
    """
    check_tensors(network, tensors, where)
    network.load_state_dict({name: value.float() for name, value in tensors.items()})


def check_tensors(network: torch.nn.Module, tensors: dict[str, Tensor], where: str) -> None:
    """Checks that tensors are those of a network, which may be on the device `meta` and so have no memory.

    Raises:
        BitstreamError: If one is missing, too many, of another size, or not finite.
    """
    wanted = network.state_dict()
    if set(tensors) != set(wanted):
        odd = sorted(set(tensors) ^ set(wanted))
        raise BitstreamError(f"{where}tensors of the network are missing or unknown: {', '.join(odd[:3])}")
    for name, value in wanted.items():
        found = tensors[name]
        if found.shape != value.shape or not found.dtype.is_floating_point:
            raise BitstreamError(f"{where}'{name}' is {found.dtype} {tuple(found.shape)}, not {tuple(value.shape)}")
        if not bool(found.isfinite().all()):
            raise BitstreamError(f"{where}'{name}' of the network is not finite")
