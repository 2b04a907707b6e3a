"""Visible area of each Gaussian in each view, measured with the renderer."""

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, UInt16

from splatwire.anchors.export.neural import PossibleGaussians, gaussians_in_view
from splatwire.anchors.head_gradients import visible_anchors
from splatwire.errors import InvalidValueError
from splatwire.ops.threads import one_blas_thread
from splatwire.types import AnchorScene, Cameras, Gaussians

GHOST_OPACITY = 0.008
"""Opacity given to Gaussians that a view does not draw, so that their visibility can be measured."""
MIN_ALPHA = 1 / 255
"""Minimum alpha that renderers draw."""
EachGradient: TypeAlias = Callable[..., None]
"""Function with the signature of `splatwire.render.cpu.each_gradient_cpu`. It is passed as an argument, because
exporters must not import renderers.
"""


class VisibleAreas:
    """Visible area of each Gaussian in each view, in square pixels.

    Args:
        num_views: Number of views, C.
        num_gaussians: Number of Gaussians that the scene can draw, S (see `PossibleGaussians`).
    """

    def __init__(self, num_views: int, num_gaussians: int) -> None:
        self._halves: UInt16[np.ndarray, "C S"] = np.zeros((num_views, num_gaussians), np.uint16)

    def put(self, view: int, indices: np.ndarray, areas: Float[np.ndarray, "M"]) -> None:
        """Stores the visible areas of a range of Gaussians in one view, rounded to bfloat16.

        Args:
            view: Index of the view.
            indices: Indices of the M Gaussians.
            areas: Their visible areas, square pixels.
        """
        whole = np.maximum(areas, 0).astype(np.float32).view(np.uint32)
        self._halves[view, indices] = (whole + (0x7FFF + (whole >> 16 & 1))) >> 16

    def part(self, first: int, last: int) -> Float[np.ndarray, "C M"]:
        """Returns the areas of the Gaussians from `first` to `last` (exclusive) in all views."""
        return (self._halves[:, first:last].astype(np.uint32) << 16).view(np.float32)

    def any(self) -> bool:
        """Returns True if at least one Gaussian is visible in a view."""
        return bool(self._halves.any())


@one_blas_thread()  # small matrices
def visible_areas(
    scene: AnchorScene,
    possible: PossibleGaussians,
    cameras: Cameras,
    each_gradient: EachGradient,
    progress: Callable[[float], None] | None = None,
) -> VisibleAreas:
    """Measures the visible area of each Gaussian in each view.

    Parts of a Gaussian that are hidden by nearer Gaussians do not count.

    Args:
        scene: The scene.
        possible: The Gaussians to measure: some or all of the Gaussians that the anchors of the scene can draw.
        cameras: Views in which areas are measured.
        each_gradient: Renderer with image gradients, such as `splatwire.render.cpu.each_gradient_cpu`.
        progress: Called with the completed fraction of the views, 0 to 1.

    Raises:
        InvalidValueError: If nothing is visible in any view.
    """
    areas, cameras = VisibleAreas(cameras.num_views, possible.num_gaussians), cameras.relative_to(scene.origin)
    for view in range(cameras.num_views):
        seen = np.flatnonzero(visible_anchors(scene.anchors, cameras, view)[possible.anchor_index])
        part = PossibleGaussians(possible.anchor_index[seen], possible.offset_index[seen], possible.means[seen])
        if part.num_gaussians:
            now = gaussians_in_view(scene, part, cameras.centers[view].astype(np.float32))
            opacities = np.maximum(now.opacities, np.float32(GHOST_OPACITY))
            gaussians = Gaussians(part.means, now.quats, now.scales, opacities, np.zeros_like(now.colors))
            # Divided by its opacity above the minimum that is drawn, the area does not depend on the opacity.
            areas.put(
                view,
                seen,
                _blending_weights(gaussians, cameras.select([view]), each_gradient) / (opacities - MIN_ALPHA),
            )
        if progress is not None:
            progress((view + 1) / cameras.num_views)
    if not areas.any():
        raise InvalidValueError("none of the views sees anything of the scene")
    return areas


def _blending_weights(gaussians: Gaussians, camera: Cameras, each_gradient: EachGradient) -> Float[np.ndarray, "G"]:
    """Returns the sum of each Gaussian's blending weights over all pixels of a view, as an area in square pixels.

    The image is linear in the colours of the Gaussians, so this sum is the gradient of the summed image with respect to
    the Gaussian's colour.

    Args:
        gaussians: The Gaussians.
        camera: Camera of the view.
        each_gradient: Renderer that passes on image gradients, such as `splatwire.render.each_gradient_cpu`.
    """
    weights = np.zeros(gaussians.num_gaussians, np.float32)

    def ones(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
        yield np.ones(shape, np.float32)

    def add(rows: slice, *gradients: np.ndarray) -> None:
        weights[rows] = gradients[4][:, 0]

    each_gradient(gaussians, camera, ones, add)
    return weights
