"""Warning of cameras from which a scene is hidden by their near plane."""

import logging

import numpy as np

from splatwire.anchors.appearance import Scene, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras

LOG = logging.getLogger(__name__)
_MOST_POSITIONS, _MOST_VIEWS = 50_000, 16
_HIDDEN = 0.5
"""Share of the elements in view that the near plane hides, above which a warning is logged."""


def warn_of_near_plane(scene: Scene, cameras: Cameras) -> None:
    """Logs a warning if most elements in the pictures of given cameras are too near to be drawn.

    Args:
        scene: The scene.
        cameras: The cameras, of which up to 16 are examined.
    """
    cameras = cameras.relative_to(origin_of(scene))
    positions = to_numpy(scene.positions)[:: -(-max(scene.num_elements, 1) // _MOST_POSITIONS)].astype(np.float64)
    depths = []
    for view in range(0, cameras.num_views, max(-(-cameras.num_views // _MOST_VIEWS), 1)):
        pose, K = (to_numpy(values[view]).astype(np.float64) for values in (cameras.viewmats, cameras.Ks))
        local = positions @ pose[:3, :3].T + pose[:3, 3]
        local = local[local[:, 2] > 0]
        pixels = local[:, :2] / local[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
        depths.append(local[((pixels >= 0) & (pixels <= (cameras.width, cameras.height))).all(axis=1), 2])
    seen = np.concatenate([np.empty(0), *depths])
    if len(seen) and (hidden := float((seen <= cameras.near_depth).mean())) > _HIDDEN:
        LOG.warning(
            "%.0f %% of the %s in the pictures are nearer than %g to the cameras (median: %.3g) and are not drawn: "
            "make scene and cameras larger, or give the cameras file a smaller 'near_depth'",
            100 * hidden, scene.ELEMENTS, cameras.near_depth, float(np.median(seen)),
        )  # fmt: skip
