"""A sketch of explicit Gaussians fits its byte share, improves quality and repeats with its seed."""

import dataclasses

import numpy as np
import pytest

from codec.gaussians.test_gaussians import DATAGRAM, some_splats
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.views import CalibrationViews
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.errors import InvalidValueError
from splatwire.render.importance import surrounding_cameras
from splatwire.types import Copies, SplatScene

pytestmark = pytest.mark.slow

CONFIG = SketchConfig(share=0.1, views=3, scored_views=2, num_losses=1, num_held_out_losses=1)


@pytest.fixture(scope="module")
def stream():
    return encode_scene(SplatScene(some_splats(degree=0)), DATAGRAM)


@pytest.fixture(scope="module")
def views(stream):
    return CalibrationViews(surrounding_cameras(decode_stream(stream).scene, 3, 48))


@pytest.fixture(scope="module")
def result(stream, views):
    return sketch_of(stream, decode_stream(stream), views, CONFIG)


def test_sketch_fits_its_byte_share_and_improves_quality(stream, result) -> None:
    assert 0.09 * stream.num_bytes < len(result.section) <= 0.1 * stream.num_bytes
    assert result.psnr["no loss"] > result.psnr["sketch"] > max(result.psnr["grow"], result.psnr["drop"])
    copies = decode_stream(with_section(stream, "sketch", result.section)).get(Copies)
    assert len(copies.indices) == result.num_sketched
    assert (copies.growth[0], copies.growth[2]) == (result.exponent, result.trust)


def test_the_same_seed_gives_the_same_bytes(stream, views, result) -> None:
    assert sketch_of(stream, decode_stream(stream), views, CONFIG).section == result.section


def test_copied_gaussians_have_high_importance(stream, result) -> None:
    """Copied Gaussians are larger and more opaque than most."""
    whole = decode_stream(stream).scene.splats
    copies = decode_stream(with_section(stream, "sketch", result.section)).get(Copies)
    weight = whole.opacities * np.exp(2 * np.log(whole.scales).mean(axis=1))
    assert np.median(weight[copies.indices]) > 2 * np.median(weight)


def test_invalid_arguments_are_refused(stream, views) -> None:
    complete = decode_stream(stream)
    with pytest.raises(InvalidValueError, match="no sketch fits"):
        sketch_of(stream, complete, views, dataclasses.replace(CONFIG, share=0.001))
    with pytest.raises(InvalidValueError, match="packets were lost"):
        sketch_of(stream, decode_stream(stream.with_packets(stream.packets[1:])), views, CONFIG)
    away = dataclasses.replace(views.cameras, viewmats=views.cameras.viewmats.copy())
    away.viewmats[:, 2, 3] = -1e4
    with pytest.raises(InvalidValueError, match="no view shows anything"):
        sketch_of(stream, complete, CalibrationViews(away), CONFIG)


def test_background_of_the_views_changes_the_sketch(stream, views) -> None:
    """A black Gaussian has no importance on black and high importance on white."""
    complete = decode_stream(stream)
    white = sketch_of(stream, complete, dataclasses.replace(views, background=(1.0, 1.0, 1.0)), CONFIG)
    black = sketch_of(stream, complete, views, CONFIG)
    places = [decode_stream(with_section(stream, "sketch", s.section)).get(Copies).indices for s in (white, black)]
    assert set(places[0].tolist()) != set(places[1].tolist())
