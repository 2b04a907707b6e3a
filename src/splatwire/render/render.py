"""From a scene to pictures, view by view."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.appearance import Scene, antialiased, gaussians_of_view, origin_of
from splatwire.ops.threads import one_torch_thread
from splatwire.render.antialiasing import compensated
from splatwire.render.backends import create_renderer
from splatwire.render.base import Renderer
from splatwire.scene import Cameras

Progress = Callable[[int, int], None]
"""Called with the number of views done and the number of views in all."""


def iterate_views(
    scene: Scene,
    cameras: Cameras,
    *,
    renderer: str | Renderer = "cpu",
    background: Float[Tensor, "3"] | None = None,
) -> Iterator[Float[Tensor, "H W 3"]]:
    """Draws one view after another, so that a caller need not hold all pictures.

    Args:
        scene: What to draw.
        cameras: Where from.
        renderer: A renderer or its name (`splatwire.render.backends.create_renderer`).
        background: RGB behind everything; the scene's own where absent.

    Yields:
        One picture per camera, RGB clamped to [0, 1]. No gradients: training calls the renderer itself.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: The renderer cannot run here.
    """
    draw = create_renderer(renderer) if isinstance(renderer, str) else renderer
    behind = torch.tensor(scene.background) if background is None else background
    return _views(scene, cameras.relative_to(origin_of(scene)), draw, behind)


def _views(
    scene: Scene, cameras: Cameras, draw: Renderer, background: Float[Tensor, "3"]
) -> Iterator[Float[Tensor, "H W 3"]]:
    for view in range(cameras.num_views):
        with torch.no_grad():  # inside the loop: a generator must not hold the mode while its caller works
            gaussians = gaussians_of_view(scene, cameras, view)
            if antialiased(scene):
                gaussians = compensated(gaussians, cameras, view)
            image = draw(gaussians, cameras.select([view]), background=background.to(gaussians.means))[0]
            with one_torch_thread():  # its own threads would go on spinning while the next picture needs processors
                image.clamp_(0, 1)
        yield image


def render_scene(
    scene: Scene,
    cameras: Cameras,
    *,
    renderer: str | Renderer = "cpu",
    background: Float[Tensor, "3"] | None = None,
    progress: Progress | None = None,
) -> Float[Tensor, "C H W 3"]:
    """Draws every view of `cameras`; arguments and errors as in `iterate_views`.

    Args:
        scene: What to draw.
        cameras: Where from.
        renderer: A renderer or its name.
        background: RGB behind everything; the scene's own where absent.
        progress: Called after each view.

    Returns:
        RGB in [0, 1].
    """
    images = torch.empty(cameras.num_views, cameras.height, cameras.width, 3)
    for view, image in enumerate(iterate_views(scene, cameras, renderer=renderer, background=background)):
        with one_torch_thread():  # see `_views`
            images[view] = image
        if progress is not None:
            progress(view + 1, cameras.num_views)
    return images
