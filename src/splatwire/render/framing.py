"""Views that frame a scene, for pictures of a scene without cameras."""

from dataclasses import replace

import numpy as np

from splatwire.model.appearance import Scene, explicit_gaussians, origin_of
from splatwire.ops.arrays import lower_median
from splatwire.render.importance import orbiting_cameras, outward_coverage, surrounding_cameras
from splatwire.render.up import up_of
from splatwire.scene import Cameras
from splatwire.scene.splats import Splats

_MOST = 100_000
_FAINT = 0.1
"""Opacity below which a Gaussian need not fit into the picture."""
_EDGE = 0.005
"""Share of the Gaussians that is left out at each end of each axis."""
_NEARLY_ALL, _REACH = 0.99, 4.0
"""Share of the Gaussians within the framed sphere; its largest radius over their median distance from the middle."""
_ENCLOSING = 0.5
"""Share of outward views that show something everywhere, from which a scene encloses its cameras."""


def framing_cameras(scene: Scene, num_views: int, size: int) -> Cameras:
    """Places cameras on a circle around a scene, a little from above, from where nearly all of it is in the picture.

    Cameras of a scene that encloses them (a room), and of neural anchors, are those of `surrounding_cameras`: from
    outside such a scene shows its unseen back.

    Args:
        scene: The scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If there is no view, no pixel or no element.
    """
    splats = explicit_gaussians(scene)
    if splats is None or not splats.num_gaussians or not num_views:
        return surrounding_cameras(scene, num_views, size)
    coverage = outward_coverage(splats, num_views, size)
    if float((coverage > 1).mean()) >= _ENCLOSING:
        return surrounding_cameras(scene, num_views, size)
    middle, radius = _sphere(splats)
    return replace(orbiting_cameras(middle, radius, num_views, up_of(scene), size), origin=origin_of(scene))


def _sphere(splats: Splats) -> tuple[list[float], float]:
    """Middle and radius, world units, of a sphere around nearly all Gaussians."""
    seen = splats.means[splats.opacities >= _FAINT]
    places = (seen if len(seen) else splats.means).astype(np.float64)
    places = places[:: -(-len(places) // _MOST)]
    low, high = np.quantile(places, [_EDGE, 1 - _EDGE], axis=0)
    middle = (low + high) / 2
    away = np.linalg.norm(places - middle, axis=1)
    radius = min(float(np.quantile(away, _NEARLY_ALL)), _REACH * float(lower_median(away)))
    return middle.tolist(), radius if radius > 0 else max(float(splats.scales.max()), 1e-6)
