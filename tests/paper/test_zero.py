"""Zero filling: a naive receiver of separated attributes."""

import numpy as np
import pytest

from concealment.gaps import random_context
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, SceneStream
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import conceal, concealer_names, create_concealer
from splatwire.render import render_scene
from splatwire.types import Attribute, ReceivedScene

FEATURE = 3
"""Part of the first feature group."""


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    hacpp = Packetization(100, 1, order="raster", grouping="contiguous", packaging="separated")
    return encode_scene(tiny_scene(seed=3, num_anchors=300), hacpp)


def lossy(stream: SceneStream, *parts: int) -> ReceivedScene:
    return decode_stream(stream.with_packets(p for p in stream.packets if p.id.block != 1 or p.id.part not in parts))


def test_zero_concealer_keeps_the_decoded_scene():
    context = random_context(50, 1, separated=True)
    proposal = create_concealer("zero")(context)
    for name, value in vars(context.scene.anchors).items():
        assert np.array_equal(getattr(proposal.elements, name), value)
    assert "zero" not in concealer_names()
    assert not proposal.left_out.any()
    assert bool((proposal.size_gain == 1).all())


def test_received_feature_groups_stay_and_the_rest_is_zero(stream: SceneStream):
    received = lossy(stream, 1, FEATURE + 1)
    scene, whole = conceal(received, "zero"), decode_stream(stream).scene
    rows = slice(100, 200)
    assert not received.loss_mask.column(Attribute.FEATURE)[rows].any()
    assert np.array_equal(scene.anchors.features[rows, :4], whole.elements.features[rows, :4])
    assert not scene.anchors.features[rows, 4:].any()
    assert not scene.anchors.scalings[rows].any()
    assert np.array_equal(scene.anchors.offsets, whole.elements.offsets)
    assert np.array_equal(scene.anchors.mask, whole.elements.mask)
    assert scene.hints is not None
    assert not scene.hints.left_out.any()


@pytest.mark.parametrize("parts", [(1,), (2,), (FEATURE,), (1, 2, FEATURE)])
def test_renders_omit_lost_attributes(stream: SceneStream, parts: tuple[int, ...]):
    cameras = tiny_cameras(1)
    picture = render_scene(conceal(lossy(stream, *parts), "zero"), cameras)
    assert bool(np.isfinite(picture).all())
    assert not np.array_equal(picture, render_scene(conceal(decode_stream(stream), "zero"), cameras))
