"""Renderers by name: the compiled CPU renderer, and renderers of installed packages.

A package announces a renderer under the entry-point group `splatwire.renderers`; the value of the entry point is a
function that creates the renderer.
"""

from importlib.metadata import entry_points

from splatwire.arguments import checked
from splatwire.errors import UnknownNameError
from splatwire.render.base import Renderer
from splatwire.render.cpu import render_cpu

GROUP = "splatwire.renderers"
"""Entry-point group of renderers in other packages."""
_BUILT_IN = "cpu"


def renderer_names() -> tuple[str, ...]:
    """Returns the names accepted by `create_renderer`."""
    return (_BUILT_IN, *sorted({point.name for point in entry_points(group=GROUP)} - {_BUILT_IN}))


@checked
def create_renderer(name: str) -> Renderer:
    """Creates a renderer by name; the renderer takes and returns numpy arrays.

    `cpu` compiles on first use. `reference` (simple and slow) and `gsplat` (needs a GPU) require torch.

    Raises:
        UnknownNameError: If no renderer has that name.
        BackendUnavailableError: If the renderer needs a missing package or device.
    """
    if name == _BUILT_IN:
        return render_cpu
    for point in entry_points(group=GROUP, name=name):
        renderer: Renderer = point.load()()
        return renderer
    raise UnknownNameError("renderer", name, renderer_names())
