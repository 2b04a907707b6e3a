"""Warning of scenes that are nearer than the near plane of cameras."""

from dataclasses import replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.render import near_plane, render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Cameras, SplatScene
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.splats import Splats


@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (0.3, False), (0.05, True), (1e-4, True)])
def test_scenes_behind_the_near_plane_give_a_warning(factor, warned, caplog):
    splats = ball_of_gaussians()
    small = SplatScene(replace(splats, means=splats.means * np.float32(factor)), origin=(5e5, 0.0, 0.0))
    cameras = replace(surrounding_cameras(small, 5, 64), near_depth=NEAR_DEPTH)
    poses = cameras.viewmats.copy()
    poses[:, :3, 3] = surrounding_cameras(SplatScene(splats), 5, 64).viewmats[:, :3, 3] * np.float32(factor)
    warn_of_near_plane(small, replace(cameras, viewmats=poses))
    assert ("are nearer than 0.2 to the cameras" in caplog.text) == warned
    caplog.clear()
    warn_of_near_plane(small, replace(cameras, viewmats=poses, near_depth=NEAR_DEPTH * factor))
    assert not caplog.text


def test_cameras_that_see_nothing_give_a_warning(caplog):
    scene = SplatScene(ball_of_gaussians())
    cameras = surrounding_cameras(scene, 2, 64)
    warn_of_near_plane(scene, cameras.select([]))
    poses = cameras.viewmats.copy()
    poses[:, 2, 3] = -100
    assert not caplog.text
    warn_of_near_plane(scene, replace(cameras, viewmats=poses))
    assert "no Gaussian of the scene is in the pictures" in caplog.text
    caplog.clear()
    warn_of_near_plane(replace(scene, origin=(5e5, 0.0, 0.0)), cameras)
    assert "the scene is smaller than a pixel in the pictures: it is around (500000, " in caplog.text


def test_rendering_a_scene_nearer_than_the_near_plane_gives_a_warning(caplog):
    splats = ball_of_gaussians()
    cameras = surrounding_cameras(SplatScene(splats), 2, 32)
    render_scene(splats, cameras)
    assert not caplog.text
    render_scene(splats, replace(cameras, near_depth=100.0))
    assert "are nearer than 100 to the cameras" in caplog.text


def wall(count: int, x: tuple[float, float], size: float = 1e-3) -> SplatScene:
    """Gaussians at depth 1 in front of a camera at the origin, evenly spread along x."""
    means = np.zeros((count, 3), np.float32)
    means[:, 0], means[:, 2] = np.linspace(*x, count), 1
    quats = np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    scales, colours = np.full((count, 3), size, np.float32), np.zeros((count, 1, 3), np.float32)
    return SplatScene(Splats(means, quats, scales, np.full(count, 0.5, np.float32), colours))


def camera(depth: float = 0.0) -> Cameras:
    """A camera that looks along z and shows x from -0.5 to 0.5 at depth 1."""
    pose = np.eye(4, dtype=np.float32)[None].copy()
    pose[:, 2, 3] = depth
    return Cameras(pose, np.float32([[[64, 0, 32], [0, 64, 32], [0, 0, 1]]]), 64, 64, ("one",))


def test_elements_between_those_of_a_sample_are_in_the_pictures(caplog, monkeypatch):
    monkeypatch.setattr(near_plane, "_MAX_POSITIONS", 10)
    warn_of_near_plane(wall(100, (-2.6, 40.0)), camera())  # every tenth is outside, two are inside
    assert not caplog.text


def test_large_elements_centred_outside_the_picture_are_in_the_pictures(caplog):
    warn_of_near_plane(wall(2, (-0.6, 0.6), 3.0), camera())
    assert not caplog.text
    warn_of_near_plane(wall(2, (-0.6, 0.6), 1e-3), camera())
    assert "no Gaussian of the scene is in the pictures" in caplog.text


def test_only_scenes_that_are_dots_are_smaller_than_a_pixel(caplog):
    warn_of_near_plane(wall(2, (0.0, 0.0)), camera())
    warn_of_near_plane(wall(2, (-1e-3, 1e-3), 0.3), camera())
    assert not caplog.text
    warn_of_near_plane(wall(9, (-0.5, 0.5)), camera(1e6))
    assert "the scene is smaller than a pixel in the pictures: it is around (0, 0, 1)" in caplog.text


def test_positions_that_are_not_finite_are_ignored(caplog):
    scene = wall(9, (-0.4, 0.4))
    means = scene.splats.means.copy()
    means[:4] = np.float32([[np.nan], [np.inf], [-np.inf], [np.nan]])
    broken = replace(scene, splats=replace(scene.splats, means=means))
    warn_of_near_plane(broken, camera())
    assert not caplog.text
    warn_of_near_plane(broken, camera(-100.0))
    assert "it is around (0.2, 0, 1)" in caplog.text
