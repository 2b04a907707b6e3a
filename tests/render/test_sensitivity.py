import dataclasses

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.render import render_scene
from splatwire.render.quick_sensitivity import quick_sensitivity
from splatwire.render.sensitivity import Sensitivity, render_sensitivity
from splatwire.types import RenderHints

pytestmark = pytest.mark.slow

CAMERAS = tiny_cameras(num_views=2, width=48, height=32)


@pytest.fixture(scope="module")
def scene():
    return tiny_scene(seed=3, num_anchors=60)


@pytest.fixture(scope="module")
def measured(scene):
    """Means over seeds: the gradient through the networks uses one sign pattern per view."""
    found = [render_sensitivity(scene, CAMERAS, probes=1, seed=seed) for seed in range(60)]
    return Sensitivity(*(sum(values) / 60 for values in zip(*(vars(one).values() for one in found), strict=True)))


def error_of(scene, **changes) -> float:
    complete = render_scene(scene, CAMERAS)
    wrong = render_scene(dataclasses.replace(scene, **changes), CAMERAS) - complete
    return float((wrong.astype(np.float64) ** 2).mean())


def test_removal_estimate_equals_the_cost_of_omitting_an_anchor(scene, measured) -> None:
    """Estimates are first order: the true effect of an anchor is smaller if its Gaussians hide each other."""
    estimates, truths = [], []
    for anchor in np.argsort(-measured.removal)[:8]:
        left_out = np.zeros(60, np.bool_)
        left_out[anchor] = True
        truths.append(error_of(scene, hints=RenderHints(np.ones(60, np.float32), left_out)))
        estimates.append(float(measured.removal[anchor]))
    assert 0.7 < float(np.median(np.array(estimates) / np.array(truths))) < 1.6
    assert int(np.argmax(truths)) in (0, 1, 2)


def test_feature_sensitivity_predicts_small_changes(scene, measured) -> None:
    """Averages over changes; smaller ones cross the visibility threshold as often and have a larger effect."""
    rng, features = np.random.default_rng(0), scene.anchors.features
    changes = [0.03 * rng.standard_normal(features.shape, np.float32) for _ in range(40)]
    channels = measured.channels[:, : features.shape[1]]
    expected = sum(float((channels * change.astype(np.float64) ** 2).sum()) for change in changes)
    moved = [dataclasses.replace(scene.anchors, features=features + change) for change in changes]
    assert sum(error_of(scene, anchors=anchors) for anchors in moved) == pytest.approx(expected, rel=0.1)
    np.testing.assert_allclose(measured.metric.diagonal(), measured.channels.sum(axis=0), rtol=1e-5)


def test_sensitivity_is_repeatable_and_zero_for_invisible_anchors(scene) -> None:
    once, again = (render_sensitivity(scene, CAMERAS, probes=1, seed=5) for _ in range(2))
    assert np.array_equal(once.removal, again.removal)
    assert not np.array_equal(once.removal, render_sensitivity(scene, CAMERAS, probes=1, seed=6).removal)
    assert bool((once.offset_removal[~scene.anchors.mask] == 0).all())
    shares: list[float] = []
    render_sensitivity(scene, CAMERAS, probes=1, progress=shares.append)
    assert shares == [0.5, 1.0]


def test_quick_sensitivity_approximates_full_sensitivity(scene) -> None:
    cameras = tiny_cameras(num_views=8, width=48, height=32)
    full = [render_sensitivity(scene, cameras, probes=2, seed=seed) for seed in range(12)]
    quick = [quick_sensitivity(scene, cameras, chosen=60, probes=2, seed=seed) for seed in range(12)]
    removal, seen = (sum(one.removal for one in found) / 12 for found in (full, quick))
    best = np.argsort(-removal)[:8]
    np.testing.assert_allclose(seen[best], removal[best], rtol=0.3)
    for name in ("channels", "offsets"):
        mine, true = (sum(float(getattr(one, name)[best].sum()) for one in found) for found in (quick, full))
        assert 0.15 < mine / true < 0.6, name


def test_quick_sensitivity_covers_the_requested_number_of_anchors(scene) -> None:
    cameras = tiny_cameras(num_views=4, width=48, height=32)
    few, all_of_them = (quick_sensitivity(scene, cameras, chosen=chosen, probes=2, seed=3) for chosen in (20, 60))
    estimated = few.removal > 0
    assert 10 < int(estimated.sum()) <= 20
    assert np.array_equal(few.removal[estimated], all_of_them.removal[estimated])
    assert float(few.removal.sum()) > 0.6 * float(all_of_them.removal.sum())
