"""Warnings for cameras that do not show a scene, because it is out of view or in front of the near plane."""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from splatwire.anchors.appearance import largest_sizes, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras
from splatwire.types.scene import Scene

LOG = logging.getLogger(__name__)
_MAX_POSITIONS, _MAX_VIEWS = 50_000, 16
_MAX_DOT_PIXELS = 1.0
"""Maximum extent, pixels, of most elements in a picture for them to count as a distant dot, not as a view of the scene.
"""
_EXTENT_FACTOR = 3.0
"""Extent of an element around its centre, relative to its largest size."""
_MAX_HIDDEN_SHARE = 0.5
"""Share of the elements in view that the near plane hides, above which a warning is logged."""


def warn_of_near_plane(scene: Scene, cameras: Cameras) -> None:
    """Logs a warning if given cameras show nothing of a scene, or most elements are too near to be drawn.

    Args:
        scene: The scene. Elements with coordinates that are not finite are ignored.
        cameras: The cameras, of which up to 16 are examined.
    """
    cameras = cameras.relative_to(origin_of(scene))
    cameras = cameras.select(slice(None, None, max(-(-cameras.num_views // _MAX_VIEWS), 1)))
    positions, sizes = to_numpy(scene.positions), largest_sizes(scene)
    step = -(-max(scene.num_elements, 1) // _MAX_POSITIONS)
    sample, sample_sizes = _finite(positions[::step], sizes[::step])
    if not cameras.num_views or not len(sample):
        return
    views = [_View.of(sample, sample_sizes, cameras, view) for view in range(cameras.num_views)]
    seen = np.concatenate([np.empty(0), *(view.depths[view.inside] for view in views if not view.is_dot)])
    if not len(seen) and any(view.is_dot for view in views):
        _warn_of_distance(scene, cameras, sample, "the scene is smaller than a pixel in the pictures")
        return
    if not len(seen):  # the sample may miss all elements in view, and centres outside have elements that reach in
        parts = [slice(first, first + _MAX_POSITIONS) for first in range(0, scene.num_elements, _MAX_POSITIONS)]
        seen = np.concatenate(
            [
                view.depths[view.reaches_in]
                for part in parts
                for number in range(cameras.num_views)
                for view in [_View.of(*_finite(positions[part], sizes[part]), cameras, number)]
            ]
        )
    if not len(seen):
        element = scene.ELEMENTS.removesuffix("s")
        _warn_of_distance(scene, cameras, sample, f"no {element} of the scene is in the pictures")
    elif (hidden := float((seen <= cameras.near_depth).mean())) > _MAX_HIDDEN_SHARE:
        LOG.warning(
            "%.0f %% of the %s in the pictures are nearer than %g to the cameras (median: %.3g) and are not drawn: "
            "make scene and cameras larger, or give the cameras file a smaller 'near_depth'",
            100 * hidden, scene.ELEMENTS, cameras.near_depth, float(np.median(seen)),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _View:
    """The M elements (Gaussians or anchors) of a scene that are in front of one camera.

    Attributes:
        depths: Depth of each element, world units.
        inside: Mask of the elements whose centres are in the picture, at any depth.
        reaches_in: Mask of the elements that may overlap the picture: all elements of `inside`, and elements beyond the
            near plane whose centre is outside the picture by less than their extent.
        is_dot: True if most elements of the scene are in the picture, but together cover no more than about a pixel.
    """

    depths: Float64[np.ndarray, "M"]
    inside: Bool[np.ndarray, "M"]
    reaches_in: Bool[np.ndarray, "M"]
    is_dot: bool

    @staticmethod
    def of(
        positions: Float64[np.ndarray, "N 3"], sizes: Float64[np.ndarray, "N"], cameras: Cameras, view: int
    ) -> "_View":
        """Projects the elements into a picture.

        Args:
            positions: Position of each element, relative to the same origin as the cameras.
            sizes: Largest size of each element, world units.
            cameras: The cameras.
            view: Index of the camera.
        """
        pose, K = (to_numpy(values[view]).astype(np.float64) for values in (cameras.viewmats, cameras.Ks))
        local = positions @ pose[:3, :3].T + pose[:3, 3]
        ahead = local[:, 2] > 0
        local, depths = local[ahead], local[ahead, 2]
        pixels = local[:, :2] / depths[:, None] * K[[0, 1], [0, 1]] + K[:2, 2]
        radii = sizes[ahead] * max(K[0, 0], K[1, 1]) / depths
        extents = np.where(depths > cameras.near_depth, _EXTENT_FACTOR * radii, 0.0)[:, None]
        end = np.array([cameras.width, cameras.height])
        inside = ((pixels >= 0) & (pixels <= end)).all(axis=1)
        reaches_in = ((pixels >= -extents) & (pixels <= end + extents)).all(axis=1)
        is_dot = bool(
            inside.sum() > max(len(positions) / 2, 1)
            and np.ptp(pixels[inside], axis=0).max() <= _MAX_DOT_PIXELS
            and np.ptp(positions, axis=0).max() > 0
            and radii[inside].max() <= _MAX_DOT_PIXELS
        )
        return _View(depths, inside, reaches_in, is_dot)


def _finite(positions: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    finite = np.isfinite(positions).all(axis=1)
    return positions[finite].astype(np.float64), sizes[finite]


def _warn_of_distance(scene: Scene, cameras: Cameras, positions: np.ndarray, problem: str) -> None:
    centers = to_numpy(cameras.centers).astype(np.float64)
    LOG.warning(
        "%s: it is around (%s), and the cameras are around (%s): their coordinates may be of different systems",
        problem,
        *(_described(np.median(points, axis=0) + np.array(origin_of(scene))) for points in (positions, centers)),
    )  # fmt: skip


def _described(point: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in point)
