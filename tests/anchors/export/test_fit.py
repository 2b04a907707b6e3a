import dataclasses

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.export.fit import FitCounts, fit_sh, fit_splats, quaternions
from splatwire.anchors.export.neural import gaussians_in_view, possible_gaussians
from splatwire.anchors.export.visibility import visible_areas
from splatwire.anchors.head_gradients import Spawning
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.render import render_scene
from splatwire.render.cpu import each_gradient_cpu
from splatwire.types import AnchorScene, GaussianHeads, Linear, Mlp, RenderHints, SplatScene
from splatwire.types.splats import Splats


def _blind(mlp: Mlp) -> Mlp:
    """Copy of a network that ignores its four inputs of the view."""
    weight = mlp.hidden.weight.copy()
    weight[:, -4:] = 0
    return Mlp(Linear(weight, mlp.hidden.bias), mlp.output)


def _gathered(scene: AnchorScene, cameras, degree: int = 3, counts: FitCounts | None = None) -> Splats:
    parts = list(fit_splats(scene, cameras, each_gradient_cpu, degree=degree, counts=counts))
    return Splats(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in dataclasses.fields(Splats)))


def _mean_psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(psnr(a, b).mean())


def test_possible_gaussians_with_opacity_equal_the_drawn_ones() -> None:
    scene, cameras = tiny_scene(), tiny_cameras()
    center = cameras.centers[0].astype(np.float32)
    possible = possible_gaussians(scene)
    assert possible.num_gaussians == int(scene.anchors.mask.sum())
    now = gaussians_in_view(scene, possible, center)
    spawned = Spawning(scene.anchors, scene.heads, center)
    drawn = now.opacities > 0
    assert np.array_equal(possible.anchor_index[drawn], spawned.anchor_index)
    for own, other in ((possible.means, "means"), (now.colors, "colors"), (now.quats, "quats"), (now.scales, "scales")):
        np.testing.assert_allclose(own[drawn], getattr(spawned.gaussians, other), rtol=1e-5, atol=1e-6)


def test_view_independent_scene_is_exported_exactly() -> None:
    scene, cameras = tiny_scene(), tiny_cameras(12)
    scene = dataclasses.replace(scene, heads=GaussianHeads(*(_blind(mlp) for mlp in vars(scene.heads).values())))
    counts = FitCounts()
    splats = _gathered(scene, cameras, counts=counts)
    others = tiny_cameras(5, distance=2.7)
    assert _mean_psnr(render_scene(SplatScene(splats), others), render_scene(scene, others)) > 50
    assert counts.possible == counts.written + counts.unseen + counts.faint
    assert splats.num_gaussians == counts.written


def test_higher_degrees_lower_the_fit_error() -> None:
    scene, cameras = tiny_scene(seed=4), tiny_cameras(24)
    pictures = render_scene(scene, cameras)
    exported = [SplatScene(_gathered(scene, cameras, degree)) for degree in (0, 1, 3)]
    quality = [_mean_psnr(render_scene(each, cameras), pictures) for each in exported]
    assert quality[0] + 0.3 < quality[1] < quality[2]


def test_fit_equals_weighted_least_squares() -> None:
    rng = np.random.default_rng(2)
    directions = rng.standard_normal((3, 60, 3), np.float32)
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    truth = rng.standard_normal((3, 9, 3), np.float32) * np.float32(0.2)
    colors = (np.einsum("svd,sdc->svc", sh_basis(directions, 2), truth) + 0.5).astype(np.float32)
    shares = rng.random((3, 60), np.float32)
    shares[:, ::3] = 0  # rows without weight do not count
    colors[:, ::3] = 7.0
    shares = shares / shares.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(fit_sh(directions, colors, shares, 2), truth, atol=5e-3, rtol=0.02)


def test_visible_area_is_the_unoccluded_ellipse_area() -> None:
    scene, cameras = tiny_scene(num_anchors=40), tiny_cameras(2)
    possible, view = possible_gaussians(scene), 0
    areas = visible_areas(scene, possible, cameras, each_gradient_cpu).part(0, possible.num_gaussians)
    assert areas.shape == (2, int(scene.anchors.mask.sum()))
    now = gaussians_in_view(scene, possible, cameras.centers[view].astype(np.float32))
    alone = int(np.flatnonzero(now.opacities > 0.2)[0])
    only = dataclasses.replace(
        scene, hints=RenderHints(np.ones(40, np.float32), np.arange(40) != possible.anchor_index[alone])
    )
    remaining = possible_gaussians(only)
    single = visible_areas(only, remaining, cameras, each_gradient_cpu).part(0, remaining.num_gaussians)
    assert float(single.sum()) > float(areas[:, possible.anchor_index == possible.anchor_index[alone]].sum()) > 0
    assert remaining.num_gaussians < possible.num_gaussians


def test_rotations_round_trip() -> None:
    quats = np.random.default_rng(1).standard_normal((50, 4))
    quats *= np.sign(quats[:, :1]) / np.linalg.norm(quats, axis=1, keepdims=True)
    matrices = rotation_matrices(quats)
    np.testing.assert_allclose(matrices @ matrices.swapaxes(1, 2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(quaternions(matrices), quats, atol=1e-9)


def test_unfittable_scenes_are_refused() -> None:
    scene, cameras = tiny_scene(num_anchors=20), tiny_cameras(2)
    with pytest.raises(InvalidValueError, match="degree"):
        next(fit_splats(scene, cameras, each_gradient_cpu, degree=4))
    away = dataclasses.replace(cameras, viewmats=cameras.viewmats * np.float32([-1.0, 1, -1, 1])[None, :, None])
    with pytest.raises(InvalidValueError, match="none of the views"):
        next(fit_splats(scene, away, each_gradient_cpu))
