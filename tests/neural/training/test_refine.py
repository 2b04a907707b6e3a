"""Refinement of a finished scene's context model: fewer bytes, the same picture."""

import dataclasses

import numpy as np
import pytest
import torch

from scenes import tiny_scene
from splatwire.codec import decode_stream, encode_scene, scene_in_order
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.neural.training.config import RefineConfig
from splatwire.neural.training.refine import refine_context
from splatwire.types import AnchorScene

pytestmark = pytest.mark.slow

CONFIG = RefineConfig(steps=60, batch=300)


@pytest.fixture(scope="module")
def scene() -> AnchorScene:
    """Attributes that depend on position, and a context model without that knowledge."""
    scene = tiny_scene(seed=5, num_anchors=1200)
    place = scene.anchors.positions - scene.anchors.positions.mean(axis=0)
    mix = torch.randn(3, scene.anchors.features.shape[1], generator=torch.Generator().manual_seed(1)).numpy()
    return dataclasses.replace(scene, anchors=dataclasses.replace(scene.anchors, features=40 * np.sin(place @ mix)))


def test_refinement_saves_bytes_and_keeps_the_scene(scene: AnchorScene) -> None:
    refined = refine_context(scene, CONFIG)
    before, after = encode_scene(scene), encode_scene(refined)
    assert after.num_bytes < 0.9 * before.num_bytes
    original = scene_in_order(scene, "morton").anchors
    for name, step in zip(("features", "scalings", "offsets"), scene.coding.config.base_steps, strict=True):
        error = np.abs(getattr(decode_stream(after).scene.anchors, name) - getattr(original, name))
        assert error.mean() < 0.3 * step
        assert error.max() < 1.2 * step


def test_refinement_changes_only_the_context_model(scene: AnchorScene) -> None:
    refined = refine_context(scene, CONFIG)
    assert refined.anchors is scene.anchors
    assert refined.heads is scene.heads
    assert (np.abs(refined.coding.context_model.grid.volume) == 1).all()
    assert not np.array_equal(refined.coding.context_model.grid.volume, scene.coding.context_model.grid.volume)


def test_refinement_depends_on_the_seed(scene: AnchorScene) -> None:
    config = dataclasses.replace(CONFIG, steps=5)
    weights = [
        refine_context(scene, c).coding.context_model.prior.hidden.weight
        for c in (config, config, dataclasses.replace(config, seed=1))
    ]
    assert np.array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


def test_invisible_anchors_do_not_affect_refinement(scene: AnchorScene) -> None:
    mask = scene.anchors.mask.copy()
    mask[:100] = False
    wild = scene.anchors.features.copy()
    wild[:100] = 1e6
    config = dataclasses.replace(CONFIG, steps=3)
    weights = [
        refine_context(
            dataclasses.replace(scene, anchors=dataclasses.replace(scene.anchors, mask=mask, features=features)), config
        ).coding.context_model.prior.hidden.weight
        for features in (scene.anchors.features, wild)
    ]
    assert np.array_equal(*weights)


def test_zero_steps_or_anchors_keep_the_scene(scene: AnchorScene) -> None:
    assert refine_context(scene, RefineConfig(steps=0)) is scene
    empty = dataclasses.replace(
        scene, anchors=dataclasses.replace(scene.anchors, mask=np.zeros_like(scene.anchors.mask))
    )
    assert refine_context(empty, CONFIG) is empty


def test_refinement_reports_progress(scene: AnchorScene) -> None:
    shares: list[float] = []
    refine_context(scene, dataclasses.replace(CONFIG, steps=4), progress=shares.append)
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_non_finite_rate_stops_refinement(scene: AnchorScene) -> None:
    features = scene.anchors.features.copy()
    features[0, 0] = float("nan")
    broken = dataclasses.replace(scene, anchors=dataclasses.replace(scene.anchors, features=features))
    with pytest.raises(DivergedError):
        refine_context(broken, dataclasses.replace(CONFIG, batch=1200))


def test_invalid_settings_are_refused() -> None:
    for changes in ({"steps": -1}, {"batch": 0}):
        with pytest.raises(InvalidValueError, match="refinement"):
            RefineConfig(**changes)
