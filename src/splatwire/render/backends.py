"""The renderers that there are, by name; each is imported when it is asked for."""

from collections.abc import Callable

import torch

from splatwire.errors import BackendUnavailableError, UnknownNameError
from splatwire.render.base import Renderer, TrainingRenderer


def _cpu() -> Renderer:
    from splatwire.render.cpu import render_cpu

    return render_cpu


def _reference() -> Renderer:
    from splatwire.render.reference import render_reference

    return render_reference


def _gsplat() -> Renderer:
    from splatwire.render.gsplat_backend import GsplatRenderer

    return GsplatRenderer()


_RENDERERS: dict[str, Callable[[], Renderer]] = {"cpu": _cpu, "reference": _reference, "gsplat": _gsplat}


def renderer_names() -> tuple[str, ...]:
    """Returns the names that `create_renderer` knows."""
    return tuple(_RENDERERS)


def create_renderer(name: str) -> Renderer:
    """Creates the renderer called `name`.

    `cpu` compiles on first use, `reference` is plain torch and slow, `gsplat` needs a GPU.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: It needs a package or a device that is not here.
    """
    if name not in _RENDERERS:
        raise UnknownNameError("renderer", name, _RENDERERS)
    return _RENDERERS[name]()


def create_training_renderer(device: torch.device) -> TrainingRenderer:
    """Creates the renderer that training uses for tensors on a device.

    Raises:
        BackendUnavailableError: There is none, or it needs a package or a device that is not here.
    """
    if device.type == "cpu":
        from splatwire.render.cpu import draw_cpu

        return draw_cpu
    if device.type != "cuda":
        raise BackendUnavailableError(str(device), "training draws on the CPU and, with gsplat, on CUDA devices")
    from splatwire.render.gsplat_backend import GsplatRenderer

    return GsplatRenderer().draw
