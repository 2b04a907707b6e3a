"""Footprints of elements in a set of views, and views to look from where there are no cameras."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.errors import InvalidValueError
from splatwire.model.appearance import Scene, explicit_gaussians, origin_of, spawned_gaussians
from splatwire.model.projection import project
from splatwire.ops.arrays import lower_median, to_numpy
from splatwire.ops.quaternions import rotation_matrices
from splatwire.scene import Cameras, Gaussians
from splatwire.scene.importance import Importance
from splatwire.scene.splats import Splats


def footprint_importance(scene: Scene, cameras: Cameras) -> Importance:
    """Computes each element's share of the pictures: opacity times projected area of its Gaussians, over all views.

    The area is that of the ellipse of one standard deviation, at most that of the image. What hides behind something
    else counts as if it were seen: a receiver that loses the thing in front would see it.

    Args:
        scene: The complete scene.
        cameras: Where it is looked at from; training cameras, or `surrounding_cameras`.
    """
    cameras = cameras.relative_to(origin_of(scene))
    footprint = np.zeros(scene.num_elements)
    for view in range(cameras.num_views):
        spawned = spawned_gaussians(scene, cameras, view)
        area = _footprints(spawned.gaussians, cameras, view)
        footprint += np.bincount(spawned.anchor_index, area, scene.num_elements)
    return Importance.of_footprints(footprint.astype(np.float32))


def _footprints(gaussians: Gaussians, cameras: Cameras, view: int) -> Float[np.ndarray, "G"]:
    """Opacity times area in square pixels; 0 for Gaussians beside the image."""
    projected = project(gaussians.means, gaussians.scales, rotation_matrices(gaussians.quats), cameras, view)
    xx, xy, yy = projected.covs2d.T
    area = math.pi * np.sqrt(np.maximum(xx * yy - xy * xy, 0))
    seen = projected.touches_image(cameras.width, cameras.height)
    return gaussians.opacities * np.minimum(area, cameras.width * cameras.height) * seen


def surrounding_cameras(scene: Scene, num_views: int = 16, size: int = 256) -> Cameras:
    """Places cameras around a scene of which nobody says where it was seen from; see `cameras_around`.

    Explicit Gaussians are looked at from two distances, so that details and far parts are both seen, and from the
    nearer one outwards where the scene goes on all around.

    Args:
        scene: The scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If there is no view, no pixel or no element.
    """
    splats = explicit_gaussians(scene)
    if splats is None:
        return cameras_around(scene.positions, num_views, size)
    near = replace(cameras_around(splats.means, num_views, size), origin=origin_of(scene))
    far, outwards = _moved(near, splats.means, _FAR), _turned(near)
    poses = near.viewmats.copy()
    poses[1::2] = far.viewmats[1::2]
    for view in range(2, num_views, 4):
        if float(_footprints(splats.seen_from(near.centers[view]), outwards, view).sum()) > _FULL * size * size:
            poses[view] = outwards.viewmats[view]
    return replace(near, viewmats=poses)


def outward_coverage(splats: Splats, num_views: int, size: int) -> Float[np.ndarray, "V"]:
    """Measures what cameras around the middle of a scene see when they look away from it.

    Args:
        splats: The Gaussians of the scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels.

    Returns:
        Footprints of each view over the area of its picture; above 1 it shows something nearly everywhere.

    Raises:
        InvalidValueError: If there is no view, no pixel or no element.
    """
    near = cameras_around(splats.means, num_views, size)
    outwards, step = _turned(near), -(-splats.num_gaussians // _MOST_MEASURED)
    few = splats.select(np.arange(0, splats.num_gaussians, step))
    shown = [_footprints(few.seen_from(near.centers[view]), outwards, view).sum() for view in range(num_views)]
    return np.array(shown, np.float32) * step / size**2


_MOST_MEASURED = 100_000
"""Gaussians whose footprints are measured, spread evenly; each stands for as many."""


_FAR = 2.0
"""Distance of far cameras over that of near ones: four times the median distance of the Gaussians from the middle."""
_FULL = 1.0
"""Footprints of a view, over the area of its picture, from which it shows more than nothing."""


def _moved(cameras: Cameras, positions: Float[np.ndarray, "N 3"], factor: float) -> Cameras:
    """The same cameras farther away from the middle of a scene."""
    middle = lower_median(positions)
    poses = cameras.viewmats.copy()
    places = middle + factor * (cameras.centers - middle)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], places)
    return replace(cameras, viewmats=poses)


def _turned(cameras: Cameras) -> Cameras:
    """The same cameras looking the other way."""
    poses = np.array([[-1], [1], [-1], [1]], np.float32) * cameras.viewmats
    return replace(cameras, viewmats=poses)


def cameras_around(positions: Float[Any, "N 3"], num_views: int = 16, size: int = 256) -> Cameras:
    """Places cameras evenly on a sphere around the middle of a scene, looking inwards.

    The middle is the median of the anchors, the radius twice their median distance from it: the far background of an
    unbounded scene does not push the cameras away.

    Args:
        positions: The anchors of the scene.
        num_views: Number of cameras.
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If there is no view, no pixel or no anchor.
    """
    _check(num_views, size, len(positions))
    places = to_numpy(positions).astype(np.float64)
    middle = lower_median(places)
    radius = max(2 * float(lower_median(np.linalg.norm(places - middle, axis=1))), 0.5)
    place = np.arange(num_views) + 0.5
    return _around(middle, radius, 1 - 2 * place / num_views, place * math.pi * (3 - math.sqrt(5)), size)


_UPRIGHT = {
    "x": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "-x": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "-y": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
}
"""Rotations after which y points down, by what is up before."""
_ROOM = 1.04
"""Room that is left around what is looked at."""


def orbiting_cameras(
    middle: Iterable[float], radius: float, num_views: int, up: str = "-y", size: int = 512
) -> Cameras:
    """Cameras of a walk around a ball, a little from above, from where all of it fits.

    Args:
        middle: Of the ball.
        radius: Of the ball, world units, above 0.
        num_views: Number of cameras; the last one is next to the first.
        up: What is up: `y`, `-z`, ...
        size: Width and height of the images, pixels; the field of view is 60 degrees.

    Raises:
        InvalidValueError: If there is no view or no pixel.
    """
    _check(num_views, size, 1)
    turn = np.array(_UPRIGHT[up])
    place = np.arange(num_views, dtype=np.float64)
    height, angle = np.full_like(place, -0.25), place * 2 * math.pi / max(num_views, 1)
    upright = turn @ np.array([*middle], np.float64)
    around = _around(upright, _ROOM * radius / math.sin(math.pi / 6), height, angle, size)
    turned = np.eye(4)
    turned[:3, :3] = turn
    return replace(around, viewmats=(around.viewmats.astype(np.float64) @ turned).astype(np.float32))


def _check(num_views: int, size: int, count: int) -> None:
    """Raises an error if nothing can be looked at."""
    if num_views < 1 or size < 1 or count < 1:
        raise InvalidValueError(f"{num_views} views of {size} pixels of {count} anchors show nothing")


def _around(
    middle: Float[np.ndarray, "3"],
    radius: float,
    height: Float[np.ndarray, "V"],
    turn: Float[np.ndarray, "V"],
    size: int,
) -> Cameras:
    """Cameras that look inwards from these heights and angles on a sphere."""
    num_views = len(height)
    ring = np.sqrt(1 - height * height)
    outwards = np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)
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
    return Cameras(poses.astype(np.float32), intrinsics, size, size, names)
