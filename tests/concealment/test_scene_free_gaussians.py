"""Inputs and invariances of the scene-free concealer for explicit Gaussians."""

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from close import assert_close
from concealment.gaps import gaussians
from random_numbers import Numbers
from splatwire.concealment import SceneFree, concealer_names
from splatwire.concealment.scene_free import GaussianNetwork, load_anchor_network, save_network
from splatwire.concealment.scene_free.elements import GAUSSIAN_SIGNATURE, gaussian_inputs
from splatwire.concealment.scene_free.weights import default_gaussian_weights, load_gaussian_network
from splatwire.errors import BitstreamError
from splatwire.types import LossMask, ReceivedScene
from splatwire.types.splats import Splats


def cloud(count: int = 300, loss: float = 0.3, unit: float = 1.0) -> ReceivedScene:
    rng = Numbers(5)
    positions = rng.rand(count, 3)
    scales = -np.sort(3 - rng.randn(count, 3) * 0.5, axis=1)
    known = rng.rand(count) >= loss
    opacities = np.where(known, rng.rand(count), 0.0)
    scales = scales + np.log(np.array(unit))
    return gaussians(positions * unit, opacities, known, scales)


def test_complete_scene_is_unchanged_and_finite() -> None:
    whole = SceneFree()(cloud(loss=0.0))
    assert_close(whole.size_gain, np.ones(300, np.float32))
    assert_close(whole.opacity_gain, np.ones(300, np.float32), rtol=1e-4, atol=1e-4)
    assert not bool(whole.left_out.any())
    for context in (cloud(loss=1.1), cloud(count=1, loss=0.0), cloud(count=3), cloud(loss=0.97)):
        hints = SceneFree()(context)
        assert np.array_equal(hints.left_out, ~context.fully_received)
        assert bool(np.isfinite(hints.size_gain).all() & (hints.size_gain > 0).all())
        assert bool(np.isfinite(hints.opacity_gain).all() & (hints.opacity_gain >= 0).all())


def test_result_is_invariant_to_units_and_order() -> None:
    plain, large = cloud(), cloud(unit=50.0)
    assert_close(gaussian_inputs(plain).signature, gaussian_inputs(large).signature, rtol=1e-3, atol=1e-3)
    turned = Numbers(1).randperm(300)
    other = ReceivedScene(plain.scene.select(turned), LossMask.of_elements(plain.fully_received[turned]))
    gains, others = SceneFree()(plain), SceneFree()(other)
    assert_close(gains.size_gain[turned], others.size_gain, rtol=1e-3, atol=1e-4)
    assert gaussian_inputs(plain).signature.shape[1] == GAUSSIAN_SIGNATURE


def test_untrained_network_compensates_transmittance() -> None:
    inputs = gaussian_inputs(cloud())
    size, opacity = GaussianNetwork.untrained()(inputs)
    assert_close(size, np.exp(0.15 * inputs.lost))
    through = (1 - inputs.opacity).clip(1e-4, 1 - 1e-4) ** np.exp(0.75 * inputs.lost)
    assert_close(opacity * inputs.opacity.clip(1e-4, 1 - 1e-4), 1 - through, rtol=1e-4, atol=1e-5)


def test_gaussian_network_file_is_refused_for_anchors(tmp_path) -> None:
    path = tmp_path / "some.safetensors"
    save_network(default_gaussian_weights(), path)
    inputs = gaussian_inputs(cloud())
    for one, other in zip(load_gaussian_network(path)(inputs), default_gaussian_weights()(inputs), strict=True):
        assert np.array_equal(one, other)
    with pytest.raises(BitstreamError, match="some"):
        load_anchor_network(path)
    tensors = load_file(path)
    tensors["layers.0.weight"] = np.zeros((8, 3), np.float32)
    save_file(tensors, path, metadata={"splatwire": '{"format": "splatwire-scene-free-gaussians", "version": 1}'})
    with pytest.raises(BitstreamError, match="some"):
        SceneFree(gaussian_weights=path)


@pytest.mark.needs_torch
def test_anchor_concealers_are_not_offered_for_gaussians() -> None:
    offered, of_anchors = set(concealer_names((), {Splats})), {"idw", "cari", "prior"}
    assert {"drop", "grow", "scene_free"} <= offered
    assert not of_anchors & offered
    assert of_anchors < set(concealer_names())
