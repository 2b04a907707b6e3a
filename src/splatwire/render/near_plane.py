"""Warnings of cameras that do not show a scene, because it is elsewhere or nearer than their near plane."""

import logging

import numpy as np

from splatwire.anchors.appearance import Scene, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras

LOG = logging.getLogger(__name__)
_MOST_POSITIONS, _MOST_VIEWS = 50_000, 16
_DOT_PX = 1.0
"""Largest extent of several elements in a picture that is no view of a scene, but a dot far away, pixels."""
_HIDDEN = 0.5
"""Share of the elements in view that the near plane hides, above which a warning is logged."""


def warn_of_near_plane(scene: Scene, cameras: Cameras) -> None:
    """Logs a warning if given cameras show nothing of a scene, or most elements are too near to be drawn.

    Args:
        scene: The scene.
        cameras: The cameras, of which up to 16 are examined.
    """
    cameras = cameras.relative_to(origin_of(scene))
    places = to_numpy(scene.positions)[:: -(-max(scene.num_elements, 1) // _MOST_POSITIONS)].astype(np.float64)
    depths = []
    for view in range(0, cameras.num_views, max(-(-cameras.num_views // _MOST_VIEWS), 1)):
        pose, K = (to_numpy(values[view]).astype(np.float64) for values in (cameras.viewmats, cameras.Ks))
        local = places @ pose[:3, :3].T + pose[:3, 3]
        local = local[local[:, 2] > 0]
        pixels = local[:, :2] / local[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
        inside = ((pixels >= 0) & (pixels <= (cameras.width, cameras.height))).all(axis=1)
        if inside.sum() == 1 or (inside.any() and np.ptp(pixels[inside], axis=0).max() > _DOT_PX):
            depths.append(local[inside, 2])
    seen = np.concatenate([np.empty(0), *depths])
    if cameras.num_views and len(places) and not len(seen):
        centers = to_numpy(cameras.centers).astype(np.float64)
        LOG.warning(
            "no %s of the scene is in the pictures: it is around (%s), and the cameras are around (%s): their "
            "coordinates may be of different systems", scene.ELEMENTS.removesuffix("s"),
            *(_described(np.median(points, axis=0) + np.array(origin_of(scene))) for points in (places, centers)),
        )  # fmt: skip
    elif len(seen) and (hidden := float((seen <= cameras.near_depth).mean())) > _HIDDEN:
        LOG.warning(
            "%.0f %% of the %s in the pictures are nearer than %g to the cameras (median: %.3g) and are not drawn: "
            "make scene and cameras larger, or give the cameras file a smaller 'near_depth'",
            100 * hidden, scene.ELEMENTS, cameras.near_depth, float(np.median(seen)),
        )  # fmt: skip


def _described(point: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in point)
