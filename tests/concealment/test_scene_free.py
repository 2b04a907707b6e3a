"""Inputs, invariances and weights file of the scene-free concealer for anchors."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from close import assert_close
from concealment.gaps import changed, permuted, random_context
from random_numbers import Numbers
from splatwire.concealment import Drop, Grow, conceal
from splatwire.concealment.scene_free import (
    AnchorNetwork,
    SceneFree,
    default_anchor_weights,
    load_anchor_network,
    save_network,
)
from splatwire.concealment.scene_free.network import AnchorInputs, anchor_inputs
from splatwire.concealment.scene_free.signature import SIGNATURE, signatures
from splatwire.concealment.scene_free.surroundings import Surroundings, surroundings_of
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.types import AnchorLayout, AttributePrior, LossMask, Prior, ReceivedScene
from splatwire.types.networks import Linear


def with_known(context: ReceivedScene, known: np.ndarray) -> ReceivedScene:
    return dataclasses.replace(context, loss_mask=LossMask.of_elements(known))


def in_other_units(context: ReceivedScene, length: float, feature: float) -> ReceivedScene:
    """The same scene in another unit of length, and with scaled features."""

    def times(part: AttributePrior, factor: float) -> AttributePrior:
        return AttributePrior(part.mean * factor, part.scale * factor, part.step * factor)

    a = context.scene.anchors
    anchors = dataclasses.replace(
        a, positions=a.positions * length, scalings=a.scalings * length, features=a.features * feature
    )
    prior = dataclasses.replace(
        context[Prior], scaling=times(context[Prior].scaling, length), feature=times(context[Prior].feature, feature)
    )
    return changed(context, anchors=anchors, prior=prior)


def random_network(seed: int = 3) -> AnchorNetwork:
    network, rng = AnchorNetwork.untrained(8, seed=seed), np.random.default_rng(seed)
    layers = [
        Linear(*(rng.normal(0, 0.3, part.shape).astype(np.float32) for part in (layer.weight, layer.bias)))
        for layer in (network.hidden, network.output)
    ]
    return dataclasses.replace(network, hidden=layers[0], output=layers[1])


@pytest.fixture
def any_weights(tmp_path: Path) -> Path:
    path = tmp_path / "any.safetensors"
    save_network(random_network(), path)
    return path


def of_received(context: ReceivedScene) -> Surroundings:
    return surroundings_of(context, np.flatnonzero(context.loss_mask.fully_received))


def inputs_of(context: ReceivedScene) -> AnchorInputs:
    return anchor_inputs(context, of_received(context))


def test_untrained_network_equals_grow() -> None:
    context = random_context(200, 1)
    size, opacity = AnchorNetwork.untrained()(inputs_of(context))
    assert_close(size, Grow()(context).size_gain[context.loss_mask.fully_received])
    assert bool((opacity == 1).all())


def test_trust_scales_the_correction(any_weights: Path) -> None:
    context = random_context(200, 2)
    none, half, full = (SceneFree(weights=any_weights, trust=trust)(context) for trust in (0.0, 0.5, 1.0))
    assert_close(none.size_gain, Grow()(context).size_gain)
    assert_close(half.size_gain, np.sqrt(none.size_gain * full.size_gain))
    assert_close(half.opacity_gain, np.sqrt(full.opacity_gain))
    assert not np.array_equal(half.opacity_gain, full.opacity_gain)
    with pytest.raises(InvalidValueError, match="trust"):
        SceneFree(weights=any_weights, trust=-0.5)


def test_lost_anchors_are_left_out_and_have_no_gain(any_weights: Path) -> None:
    context = random_context(90, 1, separated=True)
    known, result = context.loss_mask.fully_received, SceneFree(weights=any_weights)(context)
    assert np.array_equal(result.left_out, Drop()(context).left_out)
    assert result.opacity_gain is not None
    assert bool((result.size_gain[~known] == 1).all())
    assert bool((result.opacity_gain[~known] == 1).all())
    assert bool((result.size_gain[known] != 1).any())


def test_result_is_invariant_to_units(any_weights: Path) -> None:
    context, method = random_context(300, 2), SceneFree(weights=any_weights)
    plain, scaled = method(context), method(in_other_units(context, 64.0, 4.0))
    assert_close(scaled.size_gain, plain.size_gain, rtol=1e-4, atol=1e-4)
    assert_close(scaled.opacity_gain, plain.opacity_gain, rtol=1e-4, atol=1e-4)


def test_values_of_lost_anchors_are_not_used(any_weights: Path) -> None:
    context, method = random_context(120, 3), SceneFree(weights=any_weights)
    gone = ~context.loss_mask.fully_received
    peeked = dataclasses.replace(
        context.scene.anchors,
        features=np.where(gone[:, None], np.full((), 1e6, np.float32), context.scene.anchors.features),
        scalings=np.where(gone[:, None], np.full((), 1e6, np.float32), context.scene.anchors.scalings),
    )
    plain, other = method(context), method(changed(context, anchors=peeked))
    assert np.array_equal(plain.size_gain, other.size_gain)
    assert np.array_equal(plain.opacity_gain, other.opacity_gain)


def test_result_is_invariant_to_anchor_order(any_weights: Path) -> None:
    context, method = random_context(150, 4), SceneFree(weights=any_weights)
    order = Numbers(4).randperm(150)
    straight, mixed = method(context), method(permuted(context, order))
    assert_close(mixed.size_gain, straight.size_gain[order], rtol=1e-4, atol=1e-5)
    assert_close(mixed.opacity_gain, straight.opacity_gain[order], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("num_known", [0, 1, 2, 5, 59, 60])
@pytest.mark.parametrize("weights", ["any", "shipped"])
def test_result_is_finite_at_any_loss_rate(num_known: int, weights: str, any_weights: Path) -> None:
    context = random_context(60, 5, loss=0)
    known = np.zeros(60, np.bool_)
    known[Numbers(5).randperm(60)[:num_known]] = True
    result = SceneFree(weights=any_weights if weights == "any" else None)(with_known(context, known))
    for value in (result.size_gain, result.opacity_gain):
        assert bool(np.isfinite(value).all())
    assert bool((result.size_gain > 0).all())
    assert np.array_equal(result.left_out, ~known)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_tiny_scenes_are_concealed(count: int, any_weights: Path) -> None:
    context = random_context(count, 6, loss=0)
    known = np.arange(count) == 0
    result = SceneFree(weights=any_weights)(with_known(context, known))
    assert len(result.size_gain) == count
    assert bool(np.isfinite(result.size_gain).all())


def test_coincident_anchors_without_size_give_finite_gains(any_weights: Path) -> None:
    context = random_context(50, 7)
    flat = dataclasses.replace(
        context.scene.anchors,
        positions=np.zeros((50, 3), np.float32),
        scalings=np.zeros_like(context.scene.anchors.scalings),
    )
    nothing = dataclasses.replace(context[Prior].scaling, mean=np.zeros((50, 6), np.float32))
    prior = dataclasses.replace(
        context[Prior], scaling=nothing, context_features=np.zeros_like(context[Prior].context_features)
    )
    result = SceneFree(weights=any_weights)(changed(context, anchors=flat, prior=prior))
    assert bool(np.isfinite(result.size_gain).all())


def test_every_anchor_layout_is_concealed() -> None:
    layout = AnchorLayout(feature_dim=6, num_offsets=3, feature_groups=(3, 3))
    result = conceal(random_context(90, 8, layout=layout), "scene_free")
    assert result.anchors.features.shape == (90, 6)


def test_size_classes_and_lost_shares_are_correct() -> None:
    context = random_context(1000, 11)
    around = of_received(context)
    largest = set((-around.log_size).argsort()[:125].tolist())
    assert set(around.classes[0].index.flatten().tolist()) <= largest
    lost = (~context.loss_mask.fully_received).astype(np.float32)
    described = signatures(context, around)
    for column, count in enumerate((4, 12, 32)):
        share = lost[around.near.index[:, :count]].mean(axis=1).clip(None, 0.97)
        assert_close(1 - np.exp(-described[:, 1 + column]), share)


def test_surroundings_of_a_subset_equal_the_selection() -> None:
    context = random_context(300, 12)
    known = context.loss_mask.fully_received
    chosen, direct = surroundings_of(context, np.arange(300)).select(known), of_received(context)
    assert np.array_equal(chosen.rows, direct.rows)
    for one, other in zip((chosen.near, *chosen.classes), (direct.near, *direct.classes), strict=True):
        assert np.array_equal(one.index, other.index)
        assert np.array_equal(one.distance, other.distance)


def test_lost_share_includes_only_neighbours_within_the_kernel() -> None:
    context = random_context(3, 13, loss=0)
    anchors = dataclasses.replace(
        context.scene.anchors,
        positions=np.array([[0.0, 0, 0], [0.5, 0, 0], [50, 0, 0]], np.float32),
        scalings=np.ones((3, 6), np.float32),
    )
    prior = dataclasses.replace(
        context[Prior], scaling=dataclasses.replace(context[Prior].scaling, mean=np.ones((3, 6), np.float32))
    )
    context = changed(context, anchors=anchors, prior=prior)
    covered = [
        float(signatures(lossy, surroundings_of(lossy, np.array([0])))[0, 4])
        for lossy in (with_known(context, np.array([True, near, not near])) for near in (True, False))
    ]
    assert covered[0] == pytest.approx(0.0, abs=1e-6)
    # the near one covers exp(-0.25 / 4) of its coverage at distance zero, in addition to the anchor itself
    weight = np.exp(np.array(-0.25 / 4, np.float32))
    assert covered[1] == pytest.approx(-float(np.log1p(-weight / (1 + weight))), abs=1e-5)


def test_signatures_are_finite_and_have_their_documented_size() -> None:
    context = random_context(80, 12, separated=True)
    around = of_received(context)
    described = signatures(context, around)
    assert described.shape == (len(around.rows), SIGNATURE)
    assert bool(np.isfinite(described).all())


def test_network_round_trips_through_its_file(any_weights: Path) -> None:
    context = random_context(60, 13)
    inputs = inputs_of(context)
    for one, other in zip(random_network()(inputs), load_anchor_network(any_weights)(inputs), strict=True):
        assert np.array_equal(one, other)


def test_shipped_network_is_small_and_changes_gains() -> None:
    network = default_anchor_weights()
    assert network.hidden.weight.nbytes + network.output.weight.nbytes < 65536
    context = random_context(400, 14, loss=0.2)
    assert not np.array_equal(SceneFree()(context).size_gain, Grow()(context).size_gain)


@pytest.mark.parametrize("damage", ["missing", "shape", "nan", "extra", "spread", "format", "version", "absent"])
def test_a_damaged_file_is_refused(damage: str, any_weights: Path) -> None:
    tensors = load_file(any_weights)
    text = '{"format": "%s", "version": %d}'
    metadata = {"splatwire": text % ("splatwire-scene-free", 1)}
    if damage == "missing":
        del tensors["layers.2.bias"]
    elif damage == "shape":
        tensors["layers.0.weight"] = np.zeros((8, 3), np.float32)
    elif damage == "nan":
        tensors["mean"][2] = float("nan")
    elif damage == "extra":
        tensors["more"] = np.zeros(1, np.float32)
    elif damage == "spread":
        tensors["spread"][0] = 0.0
    elif damage == "format":
        metadata = {"splatwire": text % ("other", 1)}
    elif damage == "version":
        metadata = {"splatwire": text % ("splatwire-scene-free", 99)}
    path = any_weights.with_name("damaged.safetensors")
    if damage != "absent":
        save_file(tensors, path, metadata=metadata)
    with pytest.raises(UnsupportedVersionError if damage == "version" else BitstreamError, match=r"damaged\.safetens"):
        SceneFree(weights=path)
