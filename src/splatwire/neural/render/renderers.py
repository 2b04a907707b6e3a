"""Factories of torch renderers."""

from collections.abc import Callable
from typing import Any

import torch

from splatwire.errors import BackendUnavailableError, UnknownNameError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.render.differentiable import draw_cpu, render_differentiable
from splatwire.neural.render.gsplat_backend import GsplatRenderer
from splatwire.neural.render.reference import render_reference
from splatwire.ops.arrays import to_arrays
from splatwire.render.base import Renderer, TrainingRenderer

_DIFFERENTIABLE: dict[str, Callable[[], Callable[..., Any]]] = {
    "cpu": lambda: render_differentiable,
    "reference": lambda: render_reference,
    "gsplat": GsplatRenderer,
}


def create_differentiable_renderer(name: str) -> Callable[..., Any]:
    """Creates a differentiable renderer that takes torch tensors and has the same arguments as `Renderer`.

    Raises:
        UnknownNameError: If no renderer has that name.
        BackendUnavailableError: If a package or the device that the renderer needs is missing.
    """
    if name not in _DIFFERENTIABLE:
        raise UnknownNameError("renderer", name, _DIFFERENTIABLE)
    return _DIFFERENTIABLE[name]()


def create_training_renderer(device: torch.device) -> TrainingRenderer:
    """Creates the renderer that training uses for tensors on a torch device.

    Raises:
        BackendUnavailableError: If no renderer supports the device, or gsplat or its CUDA device is missing.
    """
    if device.type == "cpu":
        return draw_cpu
    if device.type != "cuda":
        raise BackendUnavailableError(str(device), "training draws on the CPU and, with gsplat, on CUDA devices")
    return GsplatRenderer().draw


def reference() -> Renderer:
    """Returns the reference renderer for numpy arrays."""
    return of_arrays(render_reference)


def gsplat() -> Renderer:
    """Returns the GPU renderer (gsplat) for numpy arrays.

    Raises:
        BackendUnavailableError: If gsplat is not installed, or no CUDA device is found.
    """
    return of_arrays(GsplatRenderer())


def of_arrays(draw: Callable[..., Any]) -> Renderer:
    """Makes a renderer of numpy arrays from a renderer of torch tensors.

    Args:
        draw: The renderer of torch tensors.
    """

    def render(gaussians: Any, cameras: Any, *, background: Any) -> Any:
        return to_arrays(draw(to_tensors(gaussians), to_tensors(cameras), background=to_tensors(background)))

    return render
