"""Cameras from which a scene fills the image, for rendering scenes without cameras."""

from dataclasses import replace

import numpy as np

from splatwire.anchors.appearance import explicit_gaussians, origin_of
from splatwire.ops.arrays import lower_median
from splatwire.render.importance import orbiting_cameras, outward_coverage, surrounding_cameras
from splatwire.render.up import estimate_up_axis
from splatwire.types import Cameras
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

_MAX_GAUSSIANS = 100_000
"""Maximum number of Gaussians from which the sphere is computed; larger scenes are sampled evenly."""
_MIN_OPACITY = 0.1
"""Opacity below which Gaussians are ignored when the scene is fitted into the image."""
_IGNORED_SHARE = 0.005
"""Share of the Gaussians that is ignored at each end of each axis."""
_FRAMED_SHARE = 0.99
"""Share of the Gaussians that must be inside the framed sphere."""
_MAX_RADIUS = 4.0
"""Maximum radius of the sphere, in multiples of the Gaussians' median distance from its centre."""
_ENCLOSING_SHARE = 0.5
"""Minimum share of outward views that are fully covered for a scene to count as enclosing its cameras (a room)."""


def framing_cameras(scene: Scene, num_views: int, size: int) -> Cameras:
    """Places cameras that show a whole scene.

    Explicit Gaussians get cameras on a circle slightly above the scene, which fills each image. Scenes that enclose
    their cameras (rooms) and neural anchors get `surrounding_cameras` instead: from outside, surfaces that no training
    photo shows would be visible.

    Args:
        scene: The scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If the number of views, pixels or elements is 0.
    """
    splats = explicit_gaussians(scene)
    if splats is None or not splats.num_gaussians or not num_views:
        return surrounding_cameras(scene, num_views, size)
    coverage = outward_coverage(splats, num_views, size)
    if float((coverage > 1).mean()) >= _ENCLOSING_SHARE:
        return surrounding_cameras(scene, num_views, size)
    middle, radius = _sphere(splats)
    return replace(orbiting_cameras(middle, radius, num_views, estimate_up_axis(scene), size), origin=origin_of(scene))


def _sphere(splats: Splats) -> tuple[list[float], float]:
    """Returns centre and radius (world units) of a sphere around nearly all Gaussians."""
    seen = splats.means[splats.opacities >= _MIN_OPACITY]
    positions = (seen if len(seen) else splats.means).astype(np.float64)
    positions = positions[:: -(-len(positions) // _MAX_GAUSSIANS)]
    low, high = np.quantile(positions, [_IGNORED_SHARE, 1 - _IGNORED_SHARE], axis=0)
    middle = (low + high) / 2
    away = np.linalg.norm(positions - middle, axis=1)
    radius = min(float(np.quantile(away, _FRAMED_SHARE)), _MAX_RADIUS * float(lower_median(away)))
    return middle.tolist(), radius if radius > 0 else max(float(splats.scales.max()), 1e-6)
