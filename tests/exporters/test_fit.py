import dataclasses

import numpy as np
import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.errors import InvalidValueError
from splatwire.exporters.fit import FitCounts, fit_sh, fit_splats, quaternions
from splatwire.exporters.neural import slot_view, slots_of
from splatwire.exporters.visibility import visible_areas
from splatwire.metrics import psnr
from splatwire.model import AnchorScene, GaussianHeads, Linear, Mlp, RenderHints, SplatScene
from splatwire.model.gaussian_heads import spawn_gaussians
from splatwire.model.tensors import to_tensors
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.render import render_scene
from splatwire.render.differentiable import render_differentiable
from splatwire.render.reference import rotation_matrices
from splatwire.scene.splats import Splats


def _blind(mlp: Mlp) -> Mlp:
    """The same network without its four inputs about the view."""
    weight = mlp.hidden.weight.copy()
    weight[:, -4:] = 0
    return Mlp(Linear(weight, mlp.hidden.bias), mlp.output)


def _gathered(scene: AnchorScene, cameras, degree: int = 3, counts: FitCounts | None = None) -> Splats:
    parts = list(fit_splats(scene, cameras, render_differentiable, degree=degree, counts=counts))
    return Splats(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in dataclasses.fields(Splats)))


def _mean_psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(psnr(a, b).mean())


def test_slots_say_what_the_view_draws() -> None:
    scene, cameras = tiny_scene(), tiny_cameras()
    scene, center = to_tensors(scene), torch.from_numpy(cameras.centers[0]).float()
    slots = slots_of(scene)
    assert slots.num_slots == int(scene.anchors.mask.sum())
    now = slot_view(scene, slots, center)
    spawned = spawn_gaussians(scene.anchors, scene.heads, center, torch.ones(300, dtype=torch.bool))
    drawn = now.opacities > 0
    assert torch.equal(slots.anchor_index[drawn], spawned.anchor_index)
    for own, other in ((slots.means, "means"), (now.colors, "colors"), (now.quats, "quats"), (now.scales, "scales")):
        torch.testing.assert_close(own[drawn], getattr(spawned.gaussians, other))


def test_a_scene_that_no_view_changes_is_exported_as_it_is() -> None:
    scene, cameras = tiny_scene(), tiny_cameras(12)
    scene = dataclasses.replace(scene, heads=GaussianHeads(*(_blind(mlp) for mlp in vars(scene.heads).values())))
    counts = FitCounts()
    splats = _gathered(scene, cameras, counts=counts)
    others = tiny_cameras(5, distance=2.7)
    assert _mean_psnr(render_scene(SplatScene(splats), others), render_scene(scene, others)) > 50
    assert counts.possible == counts.written + counts.unseen + counts.faint
    assert splats.num_gaussians == counts.written


def test_more_harmonics_follow_the_view_better() -> None:
    scene, cameras = tiny_scene(seed=4), tiny_cameras(24)
    pictures = render_scene(scene, cameras)
    exported = [SplatScene(_gathered(scene, cameras, degree)) for degree in (0, 1, 3)]
    quality = [_mean_psnr(render_scene(each, cameras), pictures) for each in exported]
    assert quality[0] + 0.3 < quality[1] < quality[2]


def test_the_fit_is_weighted_least_squares() -> None:
    rng = torch.Generator().manual_seed(2)
    directions = torch.nn.functional.normalize(torch.randn(3, 60, 3, generator=rng), dim=2)
    truth = torch.randn(3, 9, 3, generator=rng) * 0.2
    colors = torch.einsum("svd,sdc->svc", torch.from_numpy(sh_basis(directions.numpy(), 2)), truth) + 0.5
    shares = torch.rand(3, 60, generator=rng)
    shares[:, ::3] = 0  # what has no weight has no say
    colors[:, ::3] = 7.0
    shares = shares / shares.sum(dim=1, keepdim=True)
    torch.testing.assert_close(fit_sh(directions, colors, shares, 2), truth, atol=5e-3, rtol=0.02)


def test_visible_area_is_that_of_the_ellipse_and_0_behind_others() -> None:
    scene, cameras = to_tensors(tiny_scene(num_anchors=40)), tiny_cameras(2)
    areas = visible_areas(scene, slots_of(scene), cameras, render_differentiable)
    assert areas.shape == (2, int(scene.anchors.mask.sum()))
    slots, view = slots_of(scene), 0
    now = slot_view(scene, slots, torch.from_numpy(cameras.centers[view]).float())
    alone = int((now.opacities > 0.2).nonzero()[0])
    only = dataclasses.replace(
        scene, hints=RenderHints(torch.ones(40), torch.arange(40) != slots.anchor_index[alone].item())
    )
    single = visible_areas(only, slots_of(only), cameras, render_differentiable)
    assert float(single.sum()) > float(areas[:, slots.anchor_index == slots.anchor_index[alone]].sum()) > 0
    assert slots_of(only).num_slots < slots.num_slots


def test_rotations_there_and_back() -> None:
    quats = torch.nn.functional.normalize(
        torch.randn(50, 4, generator=torch.Generator().manual_seed(1)).double(), dim=1
    )
    quats = torch.where(quats[:, :1] < 0, -quats, quats)
    matrices = rotation_matrices(quats)
    torch.testing.assert_close(matrices @ matrices.transpose(1, 2), torch.eye(3).double().expand(50, 3, 3))
    torch.testing.assert_close(quaternions(matrices), quats)


def test_what_cannot_be_fitted_is_refused() -> None:
    scene, cameras = tiny_scene(num_anchors=20), tiny_cameras(2)
    with pytest.raises(InvalidValueError, match="degree"):
        next(fit_splats(scene, cameras, render_differentiable, degree=4))
    away = dataclasses.replace(cameras, viewmats=cameras.viewmats * np.float32([-1.0, 1, -1, 1])[None, :, None])
    with pytest.raises(InvalidValueError, match="none of the views"):
        next(fit_splats(scene, away, render_differentiable))
