"""Warning of scenes that are nearer than the near plane of cameras."""

from dataclasses import replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import SplatScene
from splatwire.types.cameras import NEAR_DEPTH


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
    assert "no Gaussian of the scene is in the pictures: it is around (500000, " in caplog.text


def test_rendering_a_scene_nearer_than_the_near_plane_gives_a_warning(caplog):
    splats = ball_of_gaussians()
    cameras = surrounding_cameras(SplatScene(splats), 2, 32)
    render_scene(splats, cameras)
    assert not caplog.text
    render_scene(splats, replace(cameras, near_depth=100.0))
    assert "are nearer than 100 to the cameras" in caplog.text
