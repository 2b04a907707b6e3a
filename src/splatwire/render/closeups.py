"""Cameras close to the surfaces of a scene, like the views of a user who zooms in."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from splatwire.anchors.appearance import explicit_gaussians, origin_of
from splatwire.anchors.projection import project
from splatwire.ops.quaternions import rotation_matrices
from splatwire.render.importance import projected_footprints, surrounding_cameras
from splatwire.types import Cameras
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

DISTANCE_RATIO = 0.4
"""Ratio of the distances of a close camera and of the camera around the scene from the same surface point."""
_MAX_SAMPLE = 50_000
"""Maximum number of Gaussians among which surface points are searched; larger scenes are sampled evenly."""
_NEAR_SHARE = 0.2
"""Near plane of close cameras, as a fraction of their smallest distance from a surface point. It does not depend on
the unit of length, unlike `NEAR_DEPTH`."""
_OCCLUSION_RADIUS = 1 / 40
"""Radius of the circle around a surface point in which nearer Gaussians may hide it, relative to the image's width."""
_MIN_OCCLUSION = 1.0
"""Sum of the opacities, times the covered share of the circle, from which Gaussians hide what is behind them."""
_GOLDEN_RATIO = 0.6180339887
"""Difference of consecutive numbers modulo 1 that spreads points evenly."""


def closeup_cameras(scene: Scene, num_views: int, size: int) -> Cameras:
    """Places cameras close to the surfaces of a scene.

    Args:
        scene: The scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If the number of views, pixels or elements is 0.
    """
    # Each camera begins at a pose of `surrounding_cameras`. It turns to a point in its image that is probably on the
    # nearest surface, and moves towards this point. Neural anchors have no surface: their cameras do not move.
    cameras, splats = surrounding_cameras(scene, num_views, size), explicit_gaussians(scene)
    if splats is None:
        return cameras
    step = -(-splats.num_gaussians // _MAX_SAMPLE)
    splats = splats.select(np.arange(0, splats.num_gaussians, step))
    poses = cameras.viewmats.copy()
    distances: list[float] = []
    for view in range(num_views):
        target = _surface_point(splats, cameras, view, (view * _GOLDEN_RATIO + 0.5) % 1, step)
        if target is not None:
            poses[view] = _moved_towards(poses[view].astype(np.float64), target)
            distances.append(DISTANCE_RATIO * float(np.linalg.norm(target - cameras.centers[view])))
    near_depth = _NEAR_SHARE * min(distances) if distances else cameras.near_depth
    return replace(cameras, viewmats=poses, origin=origin_of(scene), near_depth=near_depth)


def _surface_point(
    splats: Splats, cameras: Cameras, view: int, share: float, step: int
) -> Float[np.ndarray, "3"] | None:
    """Chooses a visible point of a surface in a view.

    Args:
        splats: Every `step`-th Gaussian of the scene.
        cameras: The cameras.
        view: Index of the camera.
        share: Number from 0 to 1 that selects the point: the share of the Gaussians' total area in the image that lies
            to the left of the point.
        step: Number of Gaussians of the scene that each Gaussian of `splats` represents.

    Returns:
        World coordinates; None if the view shows nothing.
    """
    seen = splats.seen_from(cameras.centers[view])
    projected = project(seen.means, seen.scales, rotation_matrices(seen.quats), cameras, view)
    x, y = projected.means2d.T
    weights = projected_footprints(projected, seen.opacities, cameras)
    weights = np.where((x >= 0) & (x < cameras.width) & (y >= 0) & (y < cameras.height), weights, 0)
    if not weights.sum() > 0:
        return None
    order = np.argsort(x, kind="stable")
    sums = np.cumsum(weights[order], dtype=np.float64)
    chosen = order[np.searchsorted(sums, share * sums[-1])]
    radius = _OCCLUSION_RADIUS * cameras.width
    nearby = np.flatnonzero((np.hypot(x - x[chosen], y - y[chosen]) < radius) & (weights > 0))
    nearby = nearby[np.argsort(projected.depths[nearby], kind="stable")]
    covered = np.cumsum(np.minimum(step * weights[nearby] / (np.pi * radius**2), 1), dtype=np.float64)
    first = nearby[min(int(np.searchsorted(covered, min(_MIN_OCCLUSION, covered[-1] / 2))), len(nearby) - 1)]
    eye = cameras.centers[view].astype(np.float64)
    ray = splats.means[chosen].astype(np.float64) - eye
    return eye + ray * (projected.depths[first] / projected.depths[chosen])


def _moved_towards(pose: Float[np.ndarray, "4 4"], target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Turns a camera towards a point, and moves the camera closer to the point.

    Args:
        pose: World-to-camera transform.
        target: The point, world coordinates.
    """
    eye = -pose[:3, :3].T @ pose[:3, 3]
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(pose[1, :3], forward)
    right /= np.linalg.norm(right)  # above 0, as the point is in the image
    axes = np.stack([right, np.cross(forward, right), forward])
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = axes, -axes @ (target - DISTANCE_RATIO * (target - eye))
    return moved.astype(np.float32)
