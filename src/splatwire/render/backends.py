"""The renderers that there are, by name; each is imported when it is asked for."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from splatwire.errors import BackendUnavailableError, UnknownNameError
from splatwire.ops.arrays import to_arrays
from splatwire.render.base import Renderer, TrainingRenderer
from splatwire.render.cpu import each_gradient_cpu, render_cpu
from splatwire.scene import Cameras, Gaussians


def _plain(draw: Callable[..., Any]) -> Renderer:
    """A renderer of numpy arrays made of one of torch tensors."""
    from splatwire.model.tensors import to_tensors  # needs torch

    def render(gaussians: Any, cameras: Any, *, background: Any) -> Any:
        return to_arrays(draw(to_tensors(gaussians), to_tensors(cameras), background=to_tensors(background)))

    return render


def _reference() -> Renderer:
    from splatwire.render.reference import render_reference  # needs torch

    return _plain(render_reference)


def _gsplat() -> Renderer:
    from splatwire.render.gsplat_backend import GsplatRenderer  # needs torch

    return _plain(GsplatRenderer())


_RENDERERS: dict[str, Callable[[], Renderer]] = {"cpu": lambda: render_cpu, "reference": _reference, "gsplat": _gsplat}


def renderer_names() -> tuple[str, ...]:
    """Returns the names that `create_renderer` knows."""
    return tuple(_RENDERERS)


def create_renderer(name: str) -> Renderer:
    """Creates the renderer called `name`, which takes and returns numpy arrays.

    `cpu` compiles on first use, `reference` is plain torch and slow, `gsplat` needs a GPU.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: It needs a package or a device that is not here.
    """
    if name not in _RENDERERS:
        raise UnknownNameError("renderer", name, _RENDERERS)
    return _RENDERERS[name]()


def create_differentiable_renderer(name: str) -> Callable[..., Any]:
    """Creates the renderer called `name` for torch tensors: arguments as of `Renderer`, differentiable.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: It needs a package or a device that is not here.
    """
    if name == "cpu":
        from splatwire.render.differentiable import render_differentiable  # needs torch

        return render_differentiable
    if name == "reference":
        from splatwire.render.reference import render_reference  # needs torch

        return render_reference
    if name == "gsplat":
        from splatwire.render.gsplat_backend import GsplatRenderer  # needs torch

        return GsplatRenderer()
    raise UnknownNameError("renderer", name, _RENDERERS)


def gradient_source(renderer: str) -> Callable[..., None]:
    """Returns what `each_gradient_cpu` does, for a renderer by name.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: It needs a package or a device that is not here.
    """
    return each_gradient_cpu if renderer == "cpu" else partial(_each_gradient, create_differentiable_renderer(renderer))


def _each_gradient(
    draw: Callable[..., Any],
    gaussians: Gaussians,
    cameras: Cameras,
    d_image: Callable[[tuple[int, ...]], Iterator[np.ndarray]],
    use: Callable[..., None],
    background: np.ndarray | None = None,
) -> None:
    """Does as `each_gradient_cpu` with a differentiable renderer of tensors."""
    import torch  # the renderer has loaded it

    inputs = [torch.from_numpy(values.copy()).requires_grad_() for values in vars(gaussians).values()]
    behind = torch.zeros(3) if background is None else torch.from_numpy(background)
    picture = draw(Gaussians(*inputs), cameras, background=behind)[0]
    for gradient in d_image(tuple(picture.shape)):
        found = torch.autograd.grad(picture, inputs, torch.from_numpy(gradient).to(picture), retain_graph=True)
        use(slice(0, gaussians.num_gaussians), *(g.contiguous().numpy() for g in found))


def create_training_renderer(device: Any) -> TrainingRenderer:
    """Creates the renderer that training uses for tensors on a torch device.

    Raises:
        BackendUnavailableError: There is none, or it needs a package or a device that is not here.
    """
    if device.type == "cpu":
        from splatwire.render.differentiable import draw_cpu  # needs torch

        return draw_cpu
    if device.type != "cuda":
        raise BackendUnavailableError(str(device), "training draws on the CPU and, with gsplat, on CUDA devices")
    from splatwire.render.gsplat_backend import GsplatRenderer  # needs torch

    return GsplatRenderer().draw
