"""Checks for a GPU to train on."""

import importlib.util

import torch

from splatwire.errors import BackendUnavailableError

_INSTEAD = "train on the CPU with --device cpu"


def has_cuda() -> bool:
    """True if torch finds a CUDA device."""
    return torch.cuda.is_available()


def check_cuda() -> None:
    """Checks that torch finds a CUDA device and that gsplat is installed. Does not run gsplat's kernels.

    Raises:
        BackendUnavailableError: If there is no CUDA device, or gsplat is not installed. The message states which of the
            two is missing.
    """
    if not has_cuda():
        raise BackendUnavailableError("cuda", f"torch finds no CUDA device; install its CUDA build, or {_INSTEAD}")
    if importlib.util.find_spec("gsplat") is None:
        raise BackendUnavailableError("cuda", f"gsplat is missing; pip install 'splatwire[gpu]', or {_INSTEAD}")
