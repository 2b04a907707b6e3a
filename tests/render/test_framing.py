"""Views without cameras: an object fits into the picture, and an enclosing scene is seen from inside."""

import numpy as np
import pytest

from close import unit
from splatwire.anchors.projection import project
from splatwire.ops.quaternions import rotation_matrices
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import surrounding_cameras
from splatwire.render.render import render_scene
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

SIZE = 96


def _splats(means, size):
    count = len(means)
    quats = np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    scales, opacities = np.full((count, 3), size, np.float32), np.full(count, 0.8, np.float32)
    return Splats(means.astype(np.float32), quats, scales, opacities, np.zeros((count, 1, 3), np.float32))


def _seen(splats, cameras, view):
    """Share of the Gaussians with centres inside the picture and in front of the camera."""
    found = project(splats.means, splats.scales, rotation_matrices(splats.quats), cameras, view)
    inside = ((found.means2d > 0) & (found.means2d < SIZE)).all(axis=1) & (found.depths > 0)
    return float(inside.mean())


def test_long_unbalanced_object_is_fully_visible_in_every_view():
    """A body of many Gaussians and a long neck of few, as of a guitar."""
    rng = np.random.default_rng(1)
    body = 0.3 * rng.normal(size=(4000, 3))
    neck = np.stack([np.zeros(400), np.linspace(-4, 0, 400), np.zeros(400)], axis=1)
    splats = _splats(np.concatenate([body, neck]), 0.02)
    cameras = framing_cameras(SplatScene(splats), 12, SIZE)
    assert cameras.num_views == 12
    assert min(_seen(splats, cameras, view) for view in range(12)) > 0.98
    before = surrounding_cameras(SplatScene(splats), 12, SIZE)
    assert min(_seen(splats, before, view) for view in range(12)) < 0.9


def test_far_outliers_do_not_change_the_framing():
    rng = np.random.default_rng(1)
    body = rng.normal(size=(4000, 3))
    scene = SplatScene(_splats(body, 0.02))
    far = SplatScene(_splats(np.concatenate([body, np.full((8, 3), 1e4)]), 0.02))
    near, pushed = (np.linalg.norm(framing_cameras(s, 4, SIZE).centers, axis=1).max() for s in (scene, far))
    assert float(pushed) < 1.2 * float(near)


def test_enclosing_scene_is_framed_from_inside():
    rng = np.random.default_rng(1)
    shell = 5 * unit(rng.normal(size=(20000, 3)))
    inner = 0.5 * rng.normal(size=(20002, 3))
    scene = SplatScene(_splats(np.concatenate([shell, inner]), 0.2))
    cameras = framing_cameras(scene, 8, SIZE)
    assert np.array_equal(cameras.viewmats, surrounding_cameras(scene, 8, SIZE).viewmats)
    assert float(np.linalg.norm(cameras.centers, axis=1).min()) < 5


def test_single_gaussian_is_framed_and_empty_scene_refused():
    assert framing_cameras(SplatScene(_splats(np.ones((1, 3)), 0.1)), 3, SIZE).num_views == 3


@pytest.mark.parametrize("place", [framing_cameras, surrounding_cameras])
@pytest.mark.parametrize("factor", [2.0**-16, 2.0**-6, 2.0**6])
def test_pictures_do_not_depend_on_the_unit_of_length(place, factor):
    """A scene of some centimetres in metres is nearer than 0.2, the near plane of 3DGS."""
    rng = np.random.default_rng(2)
    means = unit(rng.normal(size=(300, 3)).astype(np.float32))
    large, small = (SplatScene(_splats(means * size, np.float32(0.1 * size))) for size in (1, factor))
    wanted = render_scene(large, place(large, 5, SIZE))
    assert float(np.ptp(wanted, axis=(1, 2)).min()) > 0.3
    assert np.abs(render_scene(small, place(small, 5, SIZE)) - wanted).max() < 1e-4
