"""Encoders skip invisible and invalid elements and code the others as if alone."""

import dataclasses
import logging

import numpy as np
import pytest

from scenes import tiny_causal_scene, tiny_scene
from splat_io.formats.handmade import some_splats
from splatwire.bitstream import Packetization, stream_to_bytes
from splatwire.codec import encode_scene, scene_in_order
from splatwire.errors import InvalidValueError
from splatwire.types import AnchorScene, SplatScene
from splatwire.types.validity import CHUNK_ELEMENTS, validity_of_splats

SMALL = Packetization(block_size=60, lanes=2)
NAN, INF = float("nan"), float("inf")


def _broken_anchors(scene: AnchorScene) -> AnchorScene:
    """Scene with invalid anchors 2 to 6, each for another reason; 7 is invisible, and 8 has invalid hidden offsets."""
    columns = {name: values.copy() for name, values in vars(scene.anchors).items()}
    columns["scalings"][2, 3] = -1
    columns["positions"][3, 1] = NAN
    columns["features"][4, 0] = INF
    columns["scalings"][5, 2] = NAN
    columns["mask"][6, 0] = True
    columns["offsets"][6, 0, 2] = -INF
    columns["mask"][7] = False
    columns["offsets"][8][~columns["mask"][8]] = NAN
    return dataclasses.replace(scene, anchors=dataclasses.replace(scene.anchors, **columns))


@pytest.mark.parametrize("make", [tiny_scene, tiny_causal_scene])
def test_undrawable_anchors_are_left_out(make, caplog: pytest.LogCaptureFixture) -> None:
    whole = scene_in_order(make(seed=3, num_anchors=200), "morton")
    broken = _broken_anchors(whole)
    kept = np.ones(200, np.bool_)
    kept[2:8] = False
    assert np.array_equal(broken.drawable, kept)
    tiers = (np.arange(200) % 2).astype(np.uint8)
    expected = encode_scene(whole.select(kept), SMALL, tiers=tiers[kept])
    with caplog.at_level(logging.INFO, "splatwire"):
        found = encode_scene(broken, SMALL, tiers=tiers)
    assert stream_to_bytes(found) == stream_to_bytes(expected)
    assert [r.getMessage() for r in caplog.records] == [
        "encoding: 1 of 200 anchors draw nothing and are left out",
        "encoding: 5 of 200 anchors cannot be drawn and are left out (the first is row 2)",
    ]


def test_zero_scalings_are_coded_as_the_smallest_positive_scaling() -> None:
    whole = scene_in_order(tiny_causal_scene(seed=3, num_anchors=100), "morton")
    scalings = whole.anchors.scalings.copy()
    scalings[5, 1] = 0
    flat = dataclasses.replace(whole, anchors=dataclasses.replace(whole.anchors, scalings=scalings))
    expected = scalings.copy()
    expected[5, 1] = whole.anchors.scalings[scalings > 0].min()
    expected = dataclasses.replace(whole, anchors=dataclasses.replace(whole.anchors, scalings=expected))
    assert stream_to_bytes(encode_scene(flat, SMALL)) == stream_to_bytes(encode_scene(expected, SMALL))


def test_undrawable_gaussians_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    whole = some_splats(200, 1)
    columns = {name: values.copy() for name, values in vars(whole).items()}
    columns["means"][3, 1] = NAN
    columns["sh"][4, 2, 0] = INF
    columns["scales"][5, 2] = 0
    columns["quats"][6] = 0
    columns["opacities"][7] = 0
    columns["opacities"][8] = -0.0
    broken = SplatScene(dataclasses.replace(whole, **columns))
    kept = np.ones(200, np.bool_)
    kept[3:9] = False
    tiers, classes = (np.arange(200) % 2).astype(np.uint8), np.arange(200) % 3 - 2
    expected = encode_scene(SplatScene(whole.select(kept)), SMALL, tiers=tiers[kept], class_offsets=classes[kept])
    with caplog.at_level(logging.INFO, "splatwire"):
        found = encode_scene(broken, SMALL, tiers=tiers, class_offsets=classes)
    assert stream_to_bytes(found) == stream_to_bytes(expected)
    assert [r.getMessage() for r in caplog.records] == [
        "encoding: 2 of 200 Gaussians draw nothing and are left out",
        "encoding: 4 of 200 Gaussians cannot be drawn and are left out (the first is row 3)",
    ]


def test_scene_without_drawable_elements_is_refused() -> None:
    splats = some_splats(20, 0)
    nowhere = dataclasses.replace(splats, means=splats.means * NAN)
    for broken in (nowhere, splats.select(np.zeros(0, np.int64))):
        with pytest.raises(InvalidValueError, match="nothing to encode"):
            encode_scene(SplatScene(broken), SMALL)


def test_rows_are_counted_from_the_beginning_of_the_scene() -> None:
    splats = some_splats(4, 0).select(np.arange(CHUNK_ELEMENTS + 9) % 4)
    splats.means[CHUNK_ELEMENTS + 5] = NAN
    splats.opacities[CHUNK_ELEMENTS + 7] = 0
    validity = validity_of_splats(splats)
    assert (validity.num_invisible, validity.num_invalid, validity.first_invalid) == (1, 1, CHUNK_ELEMENTS + 5)
    assert not validity.kept[[CHUNK_ELEMENTS + 5, CHUNK_ELEMENTS + 7]].any()
    assert int(validity.kept.sum()) == CHUNK_ELEMENTS + 7
