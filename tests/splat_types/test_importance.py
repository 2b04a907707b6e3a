import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from close import assert_close
from random_numbers import Numbers
from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.head_gradients import Spawning
from splatwire.render.importance import cameras_around, footprint_importance, orbiting_cameras, surrounding_cameras
from splatwire.sequence.extent import sphere_around
from splatwire.types import Anchors, Cameras
from splatwire.types.importance import Importance


def test_importance_shares_and_top_elements_are_correct() -> None:
    importance = Importance.of_footprints(np.array([1.0, 5.0, 0.0, 5.0, 9.0], np.float32))
    assert_close(importance.share, np.array([0.05, 0.25, 0.0, 0.25, 0.45], np.float32))
    assert importance.top(0.4).tolist() == [False, True, False, False, True]  # ties give the lower index
    assert not importance.top(0.0).any()
    assert importance.top(1.0).all()


def test_tiers_are_shares_of_visible_anchors() -> None:
    importance = Importance.of_footprints(np.array([1.0, 5.0, 0.0, 5.0, 9.0], np.float32))
    assert importance.tiers((0.2, 0.4)).tolist() == [2, 1, 2, 1, 0]
    assert np.array_equal(importance.tiers((0.4,)) == 0, importance.top(0.4))
    seen = np.array([True, True, True, True, False])
    assert importance.tiers((0.25,), seen).tolist() == [1, 0, 1, 1, 1]
    assert importance.tiers(()).tolist() == [0, 0, 0, 0, 0]
    for bad in ((0.7, 0.4), (-0.1,), (math.nan,)):
        with pytest.raises(ValueError, match="shares of tiers"):
            importance.tiers(bad)


def test_invisible_scene_causes_no_division_by_zero() -> None:
    assert Importance.of_footprints(np.zeros(3, np.float32)).share.tolist() == [0, 0, 0]
    assert Importance.of_footprints(np.zeros(0, np.float32)).top(0.5).shape == (0,)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_invalid_shares_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        Importance(np.array([0.5, bad], np.float32))
    with pytest.raises(ValueError, match="fraction"):
        Importance(np.array([1.0], np.float32)).top(1.5)


def test_invisible_anchor_has_no_importance_and_views_add_up() -> None:
    scene, cameras = tiny_scene(num_anchors=200), tiny_cameras()
    share = footprint_importance(scene, cameras).share
    assert float(share.sum()) == pytest.approx(1, abs=1e-5)
    away = Cameras(cameras.viewmats[:1].copy(), cameras.Ks[:1], cameras.width, cameras.height, ("away",))
    away.viewmats[:, 2] *= -1
    away.viewmats[:, 0] *= -1
    assert float(footprint_importance(scene, away).share.sum()) == 0
    both = Cameras(
        np.concatenate([cameras.viewmats, away.viewmats]), np.repeat(cameras.Ks[:1], 4, axis=0),
        cameras.width, cameras.height,
        (*cameras.names, "away"),
    )  # fmt: skip
    assert_close(footprint_importance(scene, both).share, share)


def test_footprint_equals_projection_by_central_differences() -> None:
    scene, cameras = tiny_scene(seed=1, num_anchors=40), tiny_cameras(num_views=1, width=400, height=400)
    spawned = Spawning(scene.anchors, scene.heads, cameras.centers[0].astype(np.float32))
    pose, K = cameras.viewmats[0].astype(np.float64), cameras.Ks[0].astype(np.float64)
    drawn = spawned.gaussians

    def pixels(points: np.ndarray) -> np.ndarray:
        local = (points @ pose[:3, :3].T + pose[:3, 3]) @ K.T
        return local[:, :2] / local[:, 2:]

    def slopes(point: np.ndarray) -> np.ndarray:
        steps = 1e-5 * np.eye(3)
        return (pixels(point + steps) - pixels(point - steps)).T / 2e-5

    footprint = np.zeros(40, np.float64)
    for g, anchor in enumerate(spawned.anchor_index.tolist()):
        turn = Rotation.from_quat(np.roll(drawn.quats[g], -1)).as_matrix()
        root = slopes(drawn.means[g].astype(np.float64)) @ turn @ np.diag(drawn.scales[g].astype(np.float64))
        area = math.pi * np.sqrt(np.linalg.det(root @ root.T + 0.3 * np.eye(2, dtype=np.float32)))
        footprint[anchor] += float(drawn.opacities[g]) * area
    share = footprint_importance(scene, cameras).share
    assert_close(share, (footprint / footprint.sum()).astype(np.float32), rtol=1e-3, atol=1e-5)


def test_orbit_cameras_face_the_centre() -> None:
    scene = tiny_scene(num_anchors=300)
    cameras = surrounding_cameras(scene, 12)
    rotation = cameras.viewmats[:, :3, :3]
    assert_close(
        rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3, dtype=np.float32), (12, 1, 1)), rtol=0, atol=1e-5
    )
    assert bool((np.linalg.det(rotation) > 0.99).all())
    middle = np.median(scene.anchors.positions, axis=0)
    local = np.einsum("vij,j->vi", rotation, middle) + cameras.viewmats[:, :3, 3]
    assert_close(local[:, :2], np.zeros((12, 2), np.float32), rtol=0, atol=1e-4)
    assert bool((local[:, 2] > 0).all())
    assert bool((footprint_importance(scene, cameras).share > 0).astype(np.float32).mean() > 0.9)


@pytest.mark.parametrize(("up", "axis"), [("y", [0, 1, 0]), ("-y", [0, -1, 0]), ("z", [0, 0, 1]), ("-x", [-1, 0, 0])])
def test_orbit_views_show_the_whole_scene_upright_from_above(up: str, axis: list[int]) -> None:
    points = Numbers(2).randn(500, 3) * np.array([0.02, 0.05, 0.01], np.float32) + 7
    ball = sphere_around(points)
    cameras = orbiting_cameras(ball.middle, ball.radius, 7, up, size=100)
    upwards, middle = np.array(axis, np.float32), ball.middle.astype(np.float32)
    assert bool(((cameras.centers - middle) @ upwards > 0).all())
    assert bool((cameras.viewmats[:, 1, :3] @ upwards < 0).all())  # down in the picture
    local = np.einsum("vij,nj->vni", cameras.viewmats[:, :3, :3], points) + cameras.viewmats[:, None, :3, 3]
    pixels = np.einsum("vij,vnj->vni", cameras.Ks, local)
    pixels = pixels[..., :2] / pixels[..., 2:]
    inside = ((pixels > 0) & (pixels < 100)).all(axis=2).astype(np.float32).mean(axis=1)
    assert bool((inside >= 0.998).all())
    assert float(np.abs(pixels - 50).max()) > 25  # and near the scene


def test_scene_without_anchors_has_no_views() -> None:
    empty = Anchors(*(part[:0] for part in vars(tiny_scene(num_anchors=2).anchors).values()))
    with pytest.raises(ValueError, match="show nothing"):
        cameras_around(empty.positions)
