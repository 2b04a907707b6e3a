"""Importance of the elements of a scene in pictures, and default cameras for scenes without cameras."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.anchors.appearance import explicit_gaussians, origin_of, spawned_gaussians
from splatwire.anchors.projection import Projected, project
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import lower_median, to_numpy
from splatwire.ops.quaternions import rotation_matrices
from splatwire.types import Cameras, Gaussians
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.importance import Importance
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats


def footprint_importance(scene: Scene, cameras: Cameras) -> Importance:
    """Computes the importance of each element: opacity times projected area, summed over Gaussians and views.

    Args:
        scene: The complete scene.
        cameras: Cameras, such as the training cameras.
    """
    # The area is that of the one-sigma ellipse, at most that of the image. Occlusion is ignored: if an occluding
    # element is lost, the elements behind it become visible.
    cameras = cameras.relative_to(origin_of(scene))
    footprint = np.zeros(scene.num_elements)
    for view in range(cameras.num_views):
        spawned = spawned_gaussians(scene, cameras, view)
        area = gaussian_footprints(spawned.gaussians, cameras, view)
        footprint += np.bincount(spawned.anchor_index, area, scene.num_elements)
    return Importance.of_footprints(footprint.astype(np.float32))


def gaussian_footprints(gaussians: Gaussians, cameras: Cameras, view: int) -> Float[np.ndarray, "G"]:
    """Returns opacity times projected area in square pixels for each Gaussian; 0 outside the image."""
    projected = project(gaussians.means, gaussians.scales, rotation_matrices(gaussians.quats), cameras, view)
    return projected_footprints(projected, gaussians.opacities, cameras)


def projected_footprints(
    projected: Projected, opacities: Float[np.ndarray, "G"], cameras: Cameras
) -> Float[np.ndarray, "G"]:
    """Returns opacity times projected area in square pixels for each projected Gaussian; 0 outside the image."""
    xx, xy, yy = projected.covs2d.T
    area = math.pi * np.sqrt(np.maximum(xx * yy - xy * xy, 0))
    seen = projected.touches_image(cameras.width, cameras.height)
    return opacities * np.minimum(area, cameras.width * cameras.height) * seen


HELD_OUT_VIEWS = 15
"""Number of views around a scene that only evaluations use. The poses depend on the number, and no encoder uses 15
views around a scene."""


def surrounding_cameras(scene: Scene, num_views: int = 16, size: int = 256) -> Cameras:
    """Places cameras around a scene without given cameras, to measure how the scene looks.

    Around explicit Gaussians, every second camera is at twice the distance of the others, and some near ones look
    outwards if the scene encloses them. Around anchors, all cameras are near and look inwards.

    Args:
        scene: The scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If the number of views, pixels or elements is 0.
    """
    # Near cameras show details, far ones the whole. The directions are those of `cameras_around`.
    splats = explicit_gaussians(scene)
    if splats is None:
        return replace(cameras_around(scene.positions, num_views, size), origin=origin_of(scene))
    cameras = replace(cameras_around_splats(splats, num_views, size), origin=origin_of(scene))
    far, outwards = _at_distance(cameras, splats.means, _FAR), _facing_back(cameras)
    poses = cameras.viewmats.copy()
    poses[1::2] = far.viewmats[1::2]
    for view in range(2, num_views, 4):
        if (
            float(gaussian_footprints(splats.seen_from(cameras.centers[view]), outwards, view).sum())
            > _MIN_COVERAGE * size * size
        ):
            poses[view] = outwards.viewmats[view]
    return replace(cameras, viewmats=poses)


def outward_coverage(splats: Splats, num_views: int, size: int) -> Float[np.ndarray, "V"]:
    """Measures how much of each image the Gaussians cover, for cameras around the scene that look outwards.

    Args:
        splats: The Gaussians of the scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels.

    Returns:
        For each camera, the sum of opacity times projected area over all Gaussians, divided by the area of the image.

    Raises:
        InvalidValueError: If the number of views, pixels or elements is 0.
    """
    # Above 1, nearly all of the image is covered.
    cameras = cameras_around_splats(splats, num_views, size)
    outwards, step = _facing_back(cameras), -(-splats.num_gaussians // _MAX_MEASURED)
    sample = splats.select(np.arange(0, splats.num_gaussians, step))
    covered = [
        gaussian_footprints(sample.seen_from(cameras.centers[view]), outwards, view).sum() for view in range(num_views)
    ]
    return np.array(covered, np.float32) * step / size**2


_MAX_MEASURED = 100_000
"""Maximum number of Gaussians whose footprints are computed; larger scenes are sampled evenly and the sum is scaled
up."""


_FAR = 2.0
"""Ratio of the distances of far and near cameras from the scene's centre; far cameras are at four times the median
distance of the Gaussians."""
CLOSEST = 0.5
"""Default minimum distance of cameras from the scene's centre, world units."""
_EXTENT_QUANTILE, _CLOSEST_SIZES = 0.9, 4.0
"""Minimum distance of cameras from the centre of a small scene: quantile of the distances of its Gaussians from the
centre, and factor of their median size. The larger of the two applies."""
_NEAR_SHARE = 0.4
"""Maximum near plane of cameras around a scene, as a fraction of their distance from its centre."""
_MIN_COVERAGE = 1.0
"""Minimum coverage of an outward view (`outward_coverage`) for the view to be used."""


def _at_distance(cameras: Cameras, positions: Float[np.ndarray, "N 3"], factor: float) -> Cameras:
    """Multiplies the distances of cameras from the scene's centre by a factor."""
    middle = lower_median(positions)
    poses = cameras.viewmats.copy()
    centers = middle + factor * (cameras.centers - middle)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], centers)
    return replace(cameras, viewmats=poses)


def _facing_back(cameras: Cameras) -> Cameras:
    """Rotates cameras by half a turn to look in the opposite direction."""
    poses = np.array([[-1], [1], [-1], [1]], np.float32) * cameras.viewmats
    return replace(cameras, viewmats=poses)


def cameras_around_splats(splats: Splats, num_views: int, size: int) -> Cameras:
    """Places cameras evenly on a sphere around Gaussians, looking inwards.

    The radius is at least 0.5 world units; for small scenes, this minimum is reduced to the extent of the scene.

    Args:
        splats: The Gaussians.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If the number of views, pixels or Gaussians is 0.
    """
    if not splats.num_gaussians:
        return cameras_around(splats.means, num_views, size)
    positions = splats.means.astype(np.float64)
    extent = float(np.quantile(np.linalg.norm(positions - lower_median(positions), axis=1), _EXTENT_QUANTILE))
    width = float(lower_median(splats.scales.max(axis=1).astype(np.float64)))
    closest = min(CLOSEST, max(extent, _CLOSEST_SIZES * width)) or CLOSEST
    return cameras_around(splats.means, num_views, size, closest=closest)


def cameras_around(
    positions: Float[Any, "N 3"], num_views: int = 16, size: int = 256, *, closest: float = CLOSEST
) -> Cameras:
    """Places cameras evenly on a sphere around the centre of a scene, looking inwards.

    Args:
        positions: Positions of the scene's anchors or Gaussians.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.
        closest: Minimum radius of the sphere, world units.

    Raises:
        InvalidValueError: If the number of views, pixels or positions is 0.
    """
    # The centre is the median position, the radius twice the median distance from it. Distant background of an
    # unbounded scene therefore does not push the cameras away.
    _check(num_views, size, len(positions))
    points = to_numpy(positions).astype(np.float64)
    middle = lower_median(points)
    radius = max(2 * float(lower_median(np.linalg.norm(points - middle, axis=1))), closest)
    step = np.arange(num_views) + 0.5
    return _cameras_on_sphere(middle, radius, 1 - 2 * step / num_views, step * math.pi * (3 - math.sqrt(5)), size)


_UPRIGHT = {
    "x": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "-x": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "-y": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
}
"""Rotation matrices that make y point down, by up axis of the scene."""
_RADIUS_FACTOR = 1.04
"""Factor on the radius of the framed sphere, as margin."""


def orbiting_cameras(
    middle: Iterable[float], radius: float, num_views: int, up: str = "-y", size: int = 512
) -> Cameras:
    """Places cameras on a circle slightly above a sphere, far enough that each image contains the full sphere.

    Args:
        middle: Centre of the sphere.
        radius: Radius of the sphere, world units, above 0.
        num_views: Number of cameras, evenly spaced on the full circle.
        up: Up axis of the scene: `y`, `-z`, ...
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If the number of views or pixels is 0.
    """
    _check(num_views, size, 1)
    turn = np.array(_UPRIGHT[up])
    step = np.arange(num_views, dtype=np.float64)
    y, angle = np.full_like(step, -0.25), step * 2 * math.pi / max(num_views, 1)
    upright = turn @ np.array([*middle], np.float64)
    around = _cameras_on_sphere(upright, _RADIUS_FACTOR * radius / math.sin(math.pi / 6), y, angle, size)
    turned = np.eye(4)
    turned[:3, :3] = turn
    return replace(around, viewmats=(around.viewmats.astype(np.float64) @ turned).astype(np.float32))


def _check(num_views: int, size: int, count: int) -> None:
    """Checks that the numbers of views, pixels and elements are positive."""
    if num_views < 1 or size < 1 or count < 1:
        raise InvalidValueError(f"{num_views} views of {size} pixels of {count} elements show nothing")


def _cameras_on_sphere(
    middle: Float[np.ndarray, "3"],
    radius: float,
    y: Float[np.ndarray, "V"],
    turn: Float[np.ndarray, "V"],
    size: int,
) -> Cameras:
    """Returns cameras on a sphere that look at its centre.

    Args:
        middle: Centre of the sphere.
        radius: Radius of the sphere.
        y: y coordinate of each camera relative to the centre, as a fraction of the radius, -1 to 1; y points down.
        turn: Angle of each camera around the vertical axis, radians.
        size: Width and height of the images, pixels.
    """
    num_views = len(y)
    ring = np.sqrt(1 - y * y)
    outwards = np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], axis=1)
    right = np.cross(np.array([0.0, 1.0, 0.0]), -outwards)
    right = np.where(np.linalg.norm(right, axis=1, keepdims=True) > 1e-6, right, [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.cross(-outwards, right)
    poses = np.tile(np.eye(4), (num_views, 1, 1))
    poses[:, :3, :3] = np.stack([right, down, -outwards], axis=1)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], middle + radius * outwards)
    focal = size / 2 / math.tan(math.pi / 6)
    intrinsics = np.tile(
        np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], np.float32), (num_views, 1, 1)
    )
    names = tuple(f"around_{view:03d}" for view in range(num_views))
    near_depth = min(NEAR_DEPTH, _NEAR_SHARE * radius)
    return Cameras(poses.astype(np.float32), intrinsics, size, size, names, near_depth=near_depth)
