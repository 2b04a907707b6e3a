"""Rendering of scenes, view by view."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.anchors.appearance import antialiased, as_scene, gaussians_of_view, origin_of, without_invalid
from splatwire.arguments import array_of, checked_except
from splatwire.data.camera_file import load_cameras
from splatwire.errors import InvalidValueError, check_kind, check_progress, shown
from splatwire.render.antialiasing import compensated
from splatwire.render.backends import create_renderer
from splatwire.render.base import Renderer
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.render.pictures import Pictures
from splatwire.types import Cameras
from splatwire.types.background import check_background
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

Progress = Callable[[int, int], None]
"""Called with the number of finished views and the total number of views."""


@checked_except("cameras", "renderer", "background")
def iterate_views(
    scene: Scene | ReceivedScene | Splats,
    cameras: Cameras | str | os.PathLike[str],
    *,
    renderer: str | Renderer = "cpu",
    background: Float[np.ndarray, "3"] | Sequence[float] | None = None,
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    """Renders one view after another.

    Args:
        scene: A scene, a decoded scene without losses, or explicit Gaussians.
        cameras: Cameras, or the path of a file for `splatwire.data.load_cameras`.
        renderer: A renderer or its name (`splatwire.render.backends.create_renderer`).
        background: RGB of the background, 0 to 1; None for the background of the scene.

    Yields:
        One image per camera, RGB clamped to [0, 1], float32, without gradients.

    Raises:
        UnknownNameError: If no renderer has that name.
        BackendUnavailableError: If the renderer cannot run here.
        InvalidValueError: If an argument has a wrong type or value; the message names valid ones.
        DatasetError: If the cameras file is invalid.
    """
    return _drawn_views(without_invalid(as_scene(scene)), cameras_of(cameras), renderer, background)


def _drawn_views(
    scene: Scene,
    cameras: Cameras,
    renderer: str | Renderer,
    background: Float[np.ndarray, "3"] | Sequence[float] | None,
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    """Renders one view after another, as `iterate_views` does, for a scene and cameras that are already checked."""
    draw = create_renderer(renderer) if isinstance(renderer, str) else renderer
    if not callable(draw) or isinstance(draw, type):
        raise InvalidValueError(f"expected a renderer or its name such as 'cpu', not {shown(draw)}")
    color = check_background(scene.background if background is None else background)
    return _views(scene, cameras.relative_to(origin_of(scene)), draw, np.array(color, np.float32))


def cameras_of(cameras: Cameras | str | os.PathLike[str]) -> Cameras:
    """Returns cameras as given, or reads them from a file.

    Raises:
        InvalidValueError: If the argument is neither cameras nor a path.
        DatasetError: If the file contains no cameras.
    """
    if isinstance(cameras, str | os.PathLike):
        return load_cameras(Path(cameras))
    check_kind(cameras, Cameras, "splatwire.data.load_cameras")
    return cameras


def _views(
    scene: Scene, cameras: Cameras, draw: Renderer, background: Float[np.ndarray, "3"]
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    for view in range(cameras.num_views):
        gaussians = gaussians_of_view(scene, cameras, view)
        if antialiased(scene):
            gaussians = compensated(gaussians, cameras, view)
        image = _picture(draw(gaussians, cameras.select([view]), background=background), cameras)
        yield np.clip(image, 0, 1, out=image)


def _picture(drawn: Any, cameras: Cameras) -> Float[np.ndarray, "H W 3"]:
    """Checks the result of a renderer for one view, and returns it as an array that can be changed.

    Raises:
        InvalidValueError: If the result is no picture of the size of the cameras, or not of floating-point values.
    """
    pictures = array_of(drawn, "the result of the renderer", (1, cameras.height, cameras.width, 3))
    if pictures.dtype.kind != "f":
        raise InvalidValueError(f"the result of the renderer: expected RGB from 0 to 1, not {pictures.dtype}")
    picture: np.ndarray = pictures[0]
    return picture if picture.dtype == np.float32 and picture.flags.writeable else picture.astype(np.float32)


@checked_except("cameras", "renderer", "background", "progress")
def render_scene(
    scene: Scene | ReceivedScene | Splats,
    cameras: Cameras | str | os.PathLike[str],
    *,
    renderer: str | Renderer = "cpu",
    background: Float[np.ndarray, "3"] | Sequence[float] | None = None,
    progress: Progress | None = None,
) -> Pictures:
    """Renders all views of a scene; raises the same errors as `iterate_views`.

    Args:
        scene: A scene, a decoded scene without losses, or explicit Gaussians.
        cameras: Cameras, or the path of a file for `splatwire.data.load_cameras`.
        renderer: A renderer or its name.
        background: RGB of the background, 0 to 1; None for the background of the scene.
        progress: Called after each view with the number of finished views and the total number.

    Returns:
        RGB in [0, 1], float32 (C, H, W, 3); notebooks show it as an image.
    """
    cameras = cameras_of(cameras)
    check_progress(progress)
    scene = without_invalid(as_scene(scene))
    warn_of_near_plane(scene, cameras)
    images = np.empty((cameras.num_views, cameras.height, cameras.width, 3), np.float32)
    for view, image in enumerate(_drawn_views(scene, cameras, renderer, background)):
        images[view] = image
        if progress is not None:
            progress(view + 1, cameras.num_views)
    return images.view(Pictures)
