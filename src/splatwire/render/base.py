"""What a renderer is, and the names of the ones there are."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from splatwire.errors import UnknownNameError
from splatwire.scene import Cameras, Gaussians


@runtime_checkable  # the test run checks annotations
class Renderer(Protocol):
    """Draws Gaussians; the conventions are those of 3DGS (HACPP_SPEC 2 step 6), whatever the backend."""

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"]
    ) -> Float[Tensor, "C H W 3"]:
        """Draws the same Gaussians in every view.

        Args:
            gaussians: What to draw.
            cameras: Where from, one or more views.
            background: RGB behind everything.

        Returns:
            RGB, not clamped, on the device of the Gaussians.
        """
        ...


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
