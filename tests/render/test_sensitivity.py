import dataclasses

import numpy as np
import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.model import RenderHints
from splatwire.render import render_scene
from splatwire.render.quick_sensitivity import quick_sensitivity
from splatwire.render.sensitivity import Sensitivity, render_sensitivity

CAMERAS = tiny_cameras(num_views=2, width=48, height=32)


@pytest.fixture(scope="module")
def scene():
    return tiny_scene(seed=3, num_anchors=60)


@pytest.fixture(scope="module")
def measured(scene):
    """Means over seeds: what goes through the networks follows from one sign pattern a view, however many there are."""
    found = [render_sensitivity(scene, CAMERAS, probes=1, seed=seed) for seed in range(60)]
    return Sensitivity(*(sum(values) / 60 for values in zip(*(vars(one).values() for one in found), strict=True)))


def error_of(scene, **changes) -> float:
    complete = render_scene(scene, CAMERAS)
    wrong = render_scene(dataclasses.replace(scene, **changes), CAMERAS) - complete
    return float((wrong.astype(np.float64) ** 2).mean())


def test_removal_is_what_leaving_an_anchor_out_costs(scene, measured) -> None:
    """To first order: an anchor whose Gaussians hide each other costs less than the estimate says."""
    estimates, truths = [], []
    for anchor in measured.removal.argsort(descending=True)[:8].tolist():
        left_out = np.zeros(60, np.bool_)
        left_out[anchor] = True
        truths.append(error_of(scene, hints=RenderHints(np.ones(60, np.float32), left_out)))
        estimates.append(float(measured.removal[anchor]))
    ratio = torch.tensor(estimates) / torch.tensor(truths)
    assert 0.7 < float(ratio.median()) < 1.6
    order = torch.tensor(truths).argsort(descending=True)
    assert int(order[0]) in (0, 1, 2)


def test_small_changes_of_features_cost_what_the_metric_says(scene, measured) -> None:
    """On average over changes; smaller ones cross the threshold for drawing as often, and cost more."""
    rng = torch.Generator().manual_seed(0)
    features = scene.anchors.features
    changes = [0.03 * torch.randn(features.shape, generator=rng) for _ in range(40)]
    channels = measured.channels[:, : features.shape[1]]
    expected = sum(float((channels * change.double() ** 2).sum()) for change in changes)
    moved = [dataclasses.replace(scene.anchors, features=features + change.numpy()) for change in changes]
    assert sum(error_of(scene, anchors=anchors) for anchors in moved) == pytest.approx(expected, rel=0.1)
    assert torch.allclose(measured.metric.diagonal(), measured.channels.sum(dim=0))


def test_it_is_repeatable_and_what_nobody_sees_is_worth_nothing(scene) -> None:
    once, again = (render_sensitivity(scene, CAMERAS, probes=1, seed=5) for _ in range(2))
    assert torch.equal(once.removal, again.removal)
    assert not torch.equal(once.removal, render_sensitivity(scene, CAMERAS, probes=1, seed=6).removal)
    assert bool((once.offset_removal[torch.from_numpy(~scene.anchors.mask)] == 0).all())
    shares: list[float] = []
    render_sensitivity(scene, CAMERAS, probes=1, progress=shares.append)
    assert shares == [0.5, 1.0]


def test_a_glance_says_what_looking_closely_says(scene) -> None:
    cameras = tiny_cameras(num_views=8, width=48, height=32)
    full = [render_sensitivity(scene, cameras, probes=2, seed=seed) for seed in range(12)]
    quick = [quick_sensitivity(scene, cameras, chosen=60, probes=2, seed=seed) for seed in range(12)]
    removal, seen = (sum(one.removal for one in found) / 12 for found in (full, quick))
    best = removal.argsort(descending=True)[:8]
    torch.testing.assert_close(seen[best], removal[best], rtol=0.3, atol=0)
    for name in ("channels", "offsets"):
        mine, true = (sum(float(getattr(one, name)[best].sum()) for one in found) for found in (quick, full))
        assert 0.15 < mine / true < 0.6, name


def test_a_glance_tells_apart_as_many_as_it_is_asked_for(scene) -> None:
    cameras = tiny_cameras(num_views=4, width=48, height=32)
    few, all_of_them = (quick_sensitivity(scene, cameras, chosen=chosen, probes=2, seed=3) for chosen in (20, 60))
    told = few.removal > 0
    assert 10 < int(told.sum()) <= 20
    assert torch.equal(few.removal[told], all_of_them.removal[told])
    assert float(few.removal.sum()) > 0.6 * float(all_of_them.removal.sum())
