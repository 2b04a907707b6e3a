"""`closeup_cameras`: distance from surfaces, direction, independence of hidden Gaussians."""

from dataclasses import replace

import numpy as np

from random_numbers import Numbers
from splatwire.render.closeups import DISTANCE_RATIO, closeup_cameras
from splatwire.render.importance import surrounding_cameras
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats


def sphere(count: int, radius: float) -> Splats:
    """Opaque Gaussians that cover a sphere."""
    rng = Numbers(5)
    places = rng.randn(count, 3)
    places *= np.float32(radius) / np.linalg.norm(places, axis=1, keepdims=True)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    scales = np.full((count, 3), 0.06 * radius, np.float32)
    return Splats(places, quats, scales, np.full(count, 0.95, np.float32), 0.3 * rng.randn(count, 1, 3))


def covered(count: int, radius: float, coverage: float) -> Splats:
    """A sphere of Gaussians with `coverage` times the area of the sphere."""
    size = radius * np.sqrt(4 * coverage / (0.95 * count))
    return replace(sphere(count, radius), scales=np.full((count, 3), size, np.float32))


def joined(outer: Splats, inner: Splats) -> SplatScene:
    return SplatScene(Splats(**{name: np.concatenate([v, getattr(inner, name)]) for name, v in vars(outer).items()}))


def shares_of_paths(around: Cameras, close: Cameras) -> np.ndarray:
    """Length of each camera's path to its close pose, divided by the distance of a sphere of radius 2."""
    shares = []
    for eye, before, axis in zip(close.centers, around.centers, close.viewmats[:, 2, :3], strict=True):
        path = eye - before
        assert np.allclose(path / np.linalg.norm(path), axis, atol=1e-4)  # it looks where it moved
        front = -before @ axis - np.sqrt(max(4.0 - (before @ before - (before @ axis) ** 2), 0))
        shares.append(np.linalg.norm(path) / front)
    return np.array(shares)


def test_most_cameras_keep_a_share_of_their_distance_from_the_nearest_surface():
    scene = SplatScene(sphere(3000, 2.0))
    shares = shares_of_paths(surrounding_cameras(scene, 24, 224), closeup_cameras(scene, 24, 224))
    assert (abs(shares - (1 - DISTANCE_RATIO)) < 0.1).sum() >= 20


def test_large_scenes_of_which_a_sample_is_searched_keep_their_surfaces():
    scene = joined(covered(90_000, 2.0, 1.4), covered(60_000, 1.0, 8.0))
    shares = shares_of_paths(surrounding_cameras(scene, 16, 224), closeup_cameras(scene, 16, 224))
    assert (abs(shares - (1 - DISTANCE_RATIO)) < 0.1).sum() >= 14


def test_surfaces_are_found_in_front_of_hidden_ones():
    both = joined(sphere(3000, 2.0), sphere(300, 0.7))
    outside = np.linalg.norm(closeup_cameras(both, 24, 224).centers, axis=1) > 2.0
    assert outside.sum() >= 20


def test_views_of_nothing_keep_their_cameras():
    splats = sphere(10, 1.0)
    faint = SplatScene(replace(splats, opacities=np.zeros(10, np.float32)))
    assert (closeup_cameras(faint, 8, 32).viewmats == surrounding_cameras(faint, 8, 32).viewmats).all()
