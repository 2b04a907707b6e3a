"""From a scene to pictures, view by view."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.data.camera_file import load_cameras
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model.appearance import Scene, antialiased, as_scene, gaussians_of_view, origin_of
from splatwire.model.partial import Partial
from splatwire.ops.arrays import to_numpy
from splatwire.render.antialiasing import compensated
from splatwire.render.backends import create_renderer
from splatwire.render.base import Renderer
from splatwire.reprs import summarize
from splatwire.scene import Cameras
from splatwire.scene.splats import Splats

Progress = Callable[[int, int], None]
"""Called with the number of views done and the number of views in all."""


def iterate_views(
    scene: Scene | Partial | Splats,
    cameras: Cameras | str | os.PathLike[str],
    *,
    renderer: str | Renderer = "cpu",
    background: Float[np.ndarray, "3"] | Sequence[float] | None = None,
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    """Draws one view after another, so that a caller need not hold all pictures.

    Args:
        scene: What to draw: a scene, the result of a decoder if nothing was lost, or explicit Gaussians.
        cameras: Where from; a path is read by `splatwire.data.load_cameras`.
        renderer: A renderer or its name (`splatwire.render.backends.create_renderer`).
        background: RGB behind everything, 0 to 1; the scene's own where absent.

    Yields:
        One picture per camera, RGB clamped to [0, 1]. Training calls a differentiable renderer itself.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: The renderer cannot run here.
        InvalidValueError: An argument is something else; the message says what works.
        DatasetError: The file of cameras is none.
    """
    drawn, seen = as_scene(scene), cameras_of(cameras)
    draw = create_renderer(renderer) if isinstance(renderer, str) else renderer
    if not callable(draw):
        raise InvalidValueError(f"expected a renderer or its name such as 'cpu', not {draw!r:.60}")
    behind = _color(drawn.background if background is None else background)
    return _views(drawn, seen.relative_to(origin_of(drawn)), draw, behind)


def cameras_of(cameras: Cameras | str | os.PathLike[str]) -> Cameras:
    """Returns cameras, or reads them from a file.

    Raises:
        InvalidValueError: If it is neither cameras nor a path.
        DatasetError: If the file has no cameras.
    """
    if isinstance(cameras, str | os.PathLike):
        return load_cameras(Path(cameras))
    check_kind(cameras, Cameras, "splatwire.data.load_cameras")
    return cameras


def _color(background: Any) -> Float[np.ndarray, "3"]:
    """Returns a colour as an array."""
    try:
        found = np.array(to_numpy(background), np.float32)
    except (TypeError, ValueError):
        found = np.empty(0, np.float32)
    if found.shape != (3,):
        raise InvalidValueError(f"a background is three numbers from 0 to 1, not {summarize(background)}")
    return found


def _views(
    scene: Scene, cameras: Cameras, draw: Renderer, background: Float[np.ndarray, "3"]
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    for view in range(cameras.num_views):
        gaussians = gaussians_of_view(scene, cameras, view)
        if antialiased(scene):
            gaussians = compensated(gaussians, cameras, view)
        image = draw(gaussians, cameras.select([view]), background=background)[0]
        yield np.clip(image, 0, 1, out=image)


def render_scene(
    scene: Scene | Partial | Splats,
    cameras: Cameras | str | os.PathLike[str],
    *,
    renderer: str | Renderer = "cpu",
    background: Float[np.ndarray, "3"] | Sequence[float] | None = None,
    progress: Progress | None = None,
) -> Float[np.ndarray, "C H W 3"]:
    """Draws every view of `cameras`; arguments and errors as in `iterate_views`.

    Args:
        scene: What to draw: a scene, the result of a decoder if nothing was lost, or explicit Gaussians.
        cameras: Where from; a path is read by `splatwire.data.load_cameras`.
        renderer: A renderer or its name.
        background: RGB behind everything; the scene's own where absent.
        progress: Called after each view.

    Returns:
        RGB in [0, 1].
    """
    cameras = cameras_of(cameras)
    images = np.empty((cameras.num_views, cameras.height, cameras.width, 3), np.float32)
    for view, image in enumerate(iterate_views(scene, cameras, renderer=renderer, background=background)):
        images[view] = image
        if progress is not None:
            progress(view + 1, cameras.num_views)
    return images
