import dataclasses
from typing import Any

import numpy as np
import pytest

from close import assert_close
from concealment.gaps import changed, permuted, random_context
from explicit import ball_of_gaussians
from random_numbers import Numbers
from splatwire.concealment import Concealed, conceal, concealer_names, create_concealer
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.types import AnchorLayout, AnchorScene, Attribute, Copies, LossMask, Prior, ReceivedScene

NAMES = ("drop", "prior", "idw", "cari", "grow", "scene_free")
FIELDS = {
    Attribute.FEATURE: "features",
    Attribute.SCALING: "scalings",
    Attribute.OFFSET: "offsets",
    Attribute.MASK: "mask",
}


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def assert_drawable(scene: AnchorScene) -> None:
    for name in ("positions", "features", "scalings", "offsets"):
        assert bool(np.isfinite(getattr(scene.anchors, name)).all()), name
    if scene.hints is not None:
        assert bool((scene.hints.size_gain > 0).all())
        assert bool(np.isfinite(scene.hints.size_gain).all())
    assert bool((scene.anchors.scalings >= 0).all())
    assert bool((scene.anchors.offsets[~scene.anchors.mask] == 0).all())


@pytest.mark.needs_torch
def test_all_names_are_registered() -> None:
    assert set(NAMES) <= set(concealer_names())
    for name in NAMES:
        assert create_concealer(name).name == name


def test_an_unknown_name_is_an_error_that_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown concealer 'magic'.*cari.*drop.*grow.*idw.*prior"):
        create_concealer("magic")


@pytest.mark.needs_torch
def test_an_unknown_option_is_an_error() -> None:
    with pytest.raises(InvalidValueError, match="concealer 'idw' does not take"):
        create_concealer("idw", radius=3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("separated", [False, True])
def test_received_values_stay_bit_identical(name: str, separated: bool) -> None:
    context = random_context(200, 4, separated=separated)
    before = {f: getattr(context.scene.anchors, f).copy() for f in ("positions", *FIELDS.values())}
    scene = conceal(context, name)
    assert same_bits(scene.anchors.positions, before["positions"])
    for attribute, part in FIELDS.items():
        received = context.loss_mask.column(attribute)
        decoded, concealed = before[part], getattr(scene.anchors, part)
        assert same_bits(concealed[received], decoded[received])
        assert same_bits(getattr(context.scene.anchors, part), decoded), "the input was changed in place"
    assert_drawable(scene)


class MisbehavingConcealer:
    """Proposes noise for all elements, received or not."""

    name = "vandal"

    def __call__(self, context: ReceivedScene) -> Concealed:
        other = random_context(context.scene.anchors.num_anchors, 99, loss=0)
        return Concealed.filled(other.elements)


def test_received_values_stay_despite_a_misbehaving_concealer() -> None:
    context = random_context(50, 1, separated=True)
    scene = conceal(context, MisbehavingConcealer())
    for attribute, part in FIELDS.items():
        received = context.loss_mask.column(attribute)
        assert same_bits(getattr(scene.anchors, part)[received], getattr(context.scene.anchors, part)[received])
        assert not np.array_equal(
            getattr(scene.anchors, part)[~received], getattr(context.scene.anchors, part)[~received]
        )


def test_bad_proposals_are_refused() -> None:
    context = random_context(30, 1)

    class Short(MisbehavingConcealer):
        def __call__(self, context: ReceivedScene) -> Concealed:
            return Concealed.filled(context.scene.anchors.select(np.arange(3)))

    class Explodes(MisbehavingConcealer):
        def __call__(self, context: ReceivedScene) -> Concealed:
            proposal = Concealed.filled(context.scene.anchors)
            return dataclasses.replace(proposal, size_gain=proposal.size_gain * np.float32(np.inf))

    class Negative(MisbehavingConcealer):
        def __call__(self, context: ReceivedScene) -> Concealed:
            proposal = Concealed.filled(context.scene.anchors)
            return dataclasses.replace(proposal, opacity_gain=-proposal.size_gain)

    class OtherElements(MisbehavingConcealer):
        def __call__(self, context: ReceivedScene) -> Concealed:
            return dataclasses.replace(Concealed.filled(context.scene.anchors), elements=ball_of_gaussians())

    class Nothing(MisbehavingConcealer):
        def __call__(self, context: ReceivedScene) -> Any:
            return None

    for concealer in (Short(), Explodes(), Negative(), OtherElements(), Nothing()):
        with pytest.raises(InvalidValueError, match="concealer 'vandal' returned"):
            conceal(context, concealer)


@pytest.mark.parametrize("name", NAMES)
def test_complete_scene_is_unchanged(name: str) -> None:
    context = random_context(40, 2, loss=0)
    scene = conceal(context, name)
    assert scene is context.scene


@pytest.mark.parametrize("name", NAMES)
def test_scene_without_received_anchors_has_prior_values_or_is_empty(name: str) -> None:
    context = random_context(40, 2, loss=1)
    scene = conceal(context, name)
    assert_drawable(scene)
    assert scene.hints is not None
    if name in ("drop", "grow", "scene_free"):
        assert bool(scene.hints.left_out.all())
        return
    assert not bool(scene.hints.left_out.any())
    assert_close(scene.anchors.features, context[Prior].feature.mean, rtol=0, atol=0)
    assert_close(scene.anchors.offsets.reshape(scene.num_elements, -1), context[Prior].offset.mean, rtol=0, atol=0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("num_anchors", [0, 1, 2, 5])
def test_tiny_scenes_are_concealed(name: str, num_anchors: int) -> None:
    for seed in range(6):
        for loss in (0.0, 0.5, 1.0):
            assert_drawable(conceal(random_context(num_anchors, seed, loss=loss), name))


@pytest.mark.parametrize("name", NAMES)
def test_one_received_anchor_is_enough(name: str) -> None:
    context = random_context(30, 3, loss=0)
    known = np.zeros(30, np.bool_)
    known[7] = True
    scene = conceal(dataclasses.replace(context, loss_mask=LossMask.of_elements(known)), name)
    assert_drawable(scene)
    if name == "idw":
        assert np.array_equal(scene.anchors.features, np.tile(context.scene.anchors.features[7], (30, 1)))
        assert np.array_equal(scene.anchors.mask, np.tile(context.scene.anchors.mask[7], (30, 1)))


@pytest.mark.parametrize("name", NAMES)
def test_coincident_anchors_with_zero_contexts_are_concealed(name: str) -> None:
    context = random_context(60, 6)
    anchors = dataclasses.replace(context.scene.anchors, positions=np.zeros((60, 3), np.float32))
    prior = dataclasses.replace(context[Prior], context_features=np.zeros_like(context[Prior].context_features))
    assert_drawable(conceal(changed(context, anchors=anchors, prior=prior), name))


@pytest.mark.parametrize("name", NAMES)
def test_permuting_the_anchors_permutes_the_scene(name: str) -> None:
    context = random_context(120, 8)
    order = Numbers(1).randperm(120)
    straight, mixed = conceal(context, name), conceal(permuted(context, order), name)
    assert straight.hints is not None
    assert mixed.hints is not None
    for part in FIELDS.values():
        assert_close(getattr(mixed.elements, part), getattr(straight.elements, part)[order], rtol=1e-5, atol=1e-5)
    assert_close(mixed.hints.size_gain, straight.hints.size_gain[order])
    assert np.array_equal(mixed.hints.left_out, straight.hints.left_out[order])


@pytest.mark.needs_torch
def test_missing_inputs_are_one_error_sentence() -> None:
    context = random_context(10, 0)
    with pytest.raises(InvalidValueError, match="the side information of this stream of anchors has no Copies"):
        context[Copies]
    bare = dataclasses.replace(context, records=(context[AnchorLayout],))
    with pytest.raises(
        InvalidValueError, match="concealer 'cari' needs Prior, which this stream of anchors does not have"
    ):
        conceal(bare, "cari")
    assert {"drop", "grow"} <= set(concealer_names((), bare.provides)) < set(concealer_names((), context.provides))


def test_context_with_arrays_of_unequal_length_is_refused() -> None:
    context = random_context(10, 0)
    with pytest.raises(ValueError, match="different numbers of elements"):
        dataclasses.replace(context, loss_mask=LossMask.of_elements(np.ones(9, np.bool_)))


def test_the_class_of_a_concealer_is_no_concealer() -> None:
    with pytest.raises(InvalidValueError, match="expected a concealer or its name such as 'grow', not type"):
        conceal(random_context(40, 0), type(create_concealer("grow")))
