from dataclasses import replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.rate_control.pruning import MIN_SHARE, PruningCurve, RemovalViews
from splatwire.rate_control.views import SourcePictures, ViewSets
from splatwire.render.importance import cameras_around
from splatwire.render.precision import measure_gaussians
from splatwire.types import SplatScene
from splatwire.types.splats import Splats


def with_hidden_core(splats: Splats) -> Splats:
    """The Gaussians, and as many tiny ones in an opaque ball in the middle."""
    core = Splats(
        np.concatenate([np.zeros((1, 3), np.float32), 0.02 * splats.means]),
        np.concatenate([splats.quats[:1], splats.quats]),
        np.concatenate([np.full((1, 3), 0.3, np.float32), np.full_like(splats.scales, 0.002)]),
        np.concatenate([np.ones(1, np.float32), splats.opacities]),
        np.concatenate([splats.sh[:1], splats.sh]),
    )
    names = vars(splats)
    return Splats(**{name: np.concatenate([names[name], getattr(core, name)]) for name in names})


def curve_of(scene: SplatScene) -> PruningCurve:
    measured, pictures = measure_gaussians(scene), SourcePictures(scene, ViewSets.of(scene).search)
    return PruningCurve.measured(scene, measured.removal, pictures, RemovalViews.of(scene, None))


@pytest.mark.slow
def test_share_grows_steadily_with_the_precision():
    curve = curve_of(SplatScene(ball_of_gaussians()))
    levels = np.linspace(2.5, 14, 200)
    shares = np.array([curve.best_share(level) for level in levels])
    assert (np.diff(shares) >= 0).all()
    assert np.diff(shares).max() < 0.1
    assert MIN_SHARE <= shares[0] < shares[-1] <= 1


@pytest.mark.slow
def test_hidden_gaussians_are_removed_first():
    splats = ball_of_gaussians()
    scene = SplatScene(with_hidden_core(splats))
    curve = curve_of(scene)
    hidden = set(range(201, 401)) & set(curve.kept(0.5).tolist())
    assert len(hidden) <= 4  # a close view may be inside the ball, which is translucent
    assert curve.best_share(8.0) < 0.75


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [2, 3])
def test_few_gaussians_are_measured_without_warnings(count):
    curve = curve_of(SplatScene(ball_of_gaussians()).select(np.arange(count)))
    assert (np.diff(curve.errors) <= 0).all()


@pytest.mark.slow
def test_kept_gaussians_ascend_and_are_nested():
    curve = curve_of(SplatScene(ball_of_gaussians()))
    few, many = curve.kept(0.3), curve.kept(0.6)
    assert (np.diff(many) > 0).all()
    assert (len(few), len(many)) == (60, 120)
    assert set(few.tolist()) < set(many.tolist())


@pytest.mark.slow
def test_measuring_again_keeps_better_gaussians():
    scene = SplatScene(ball_of_gaussians())
    removal, pictures = measure_gaussians(scene).removal, SourcePictures(scene, ViewSets.of(scene).held_out)
    curves = [
        PruningCurve.measured(scene, removal, pictures, views)
        for views in (RemovalViews(()), RemovalViews.of(scene, None))
    ]
    once, again = (pictures.mean_psnr(scene.select(curve.kept(0.2))) for curve in curves)
    assert again > once + 0.3


def test_measures_are_repeatable_and_follow_parts():
    scene = SplatScene(ball_of_gaussians())
    once, again = measure_gaussians(scene), measure_gaussians(scene)
    assert (once.removal == again.removal).all()
    assert (once.class_offsets == again.class_offsets).all()
    parts = measure_gaussians(scene, part=60)
    assert (parts.removal > 0).all()


@pytest.mark.parametrize("count", [3, 6, 20])
def test_sets_of_given_cameras_are_disjoint(count):
    scene = SplatScene(ball_of_gaussians())
    cameras = cameras_around(scene.splats.means, count, 500)
    views = ViewSets.of(scene, cameras)
    names = [set(part.names) for part in (views.measured, views.search, views.held_out)]
    if count < 6:
        assert names[0] == set(cameras.names)
        assert views.held_out.num_views == 15
    else:
        assert sum(map(len, names)) == len(set().union(*names))
        assert set().union(*names) <= set(cameras.names)
        assert views.held_out.width == 400


def test_views_around_a_scene_differ_between_the_sets():
    scene = SplatScene(ball_of_gaussians())
    views = ViewSets.of(scene)
    assert views.measured is None
    apart = views.search.centers[:, None] - views.held_out.centers[None]
    assert np.linalg.norm(apart, axis=2).min() > 1e-3


def test_pictures_of_the_source_have_no_error():
    scene = SplatScene(ball_of_gaussians())
    pictures = SourcePictures(scene, cameras_around(scene.splats.means, 3, 48))
    assert pictures.mean_psnr(scene) == np.inf
    darker = replace(scene, splats=replace(scene.splats, opacities=scene.splats.opacities / 2))
    assert 5 < pictures.mean_psnr(darker) < 40
