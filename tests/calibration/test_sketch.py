import dataclasses

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splatwire.bitstream import Packetization
from splatwire.calibration.pseudo_loss import calibration_data
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_anchors import AnchorSketch
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.sketch_fit import SketchFit, fit_sketch, sketch_material
from splatwire.calibration.views import CalibrationViews
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.concealment import conceal
from splatwire.concealment.sketch.concealer import buckets_of, sizes_of, sketched_attributes, with_sketch
from splatwire.concealment.sketch.section import read_sketch, write_sketch
from splatwire.errors import InvalidValueError
from splatwire.render import render_scene
from splatwire.render.sensitivity import render_sensitivity
from splatwire.types import PredictedPositions

pytestmark = pytest.mark.slow

VIEWS = CalibrationViews(tiny_cameras(num_views=3, width=48, height=32))
CONFIG = SketchConfig(share=0.1, views=3, scored_views=2)


@pytest.fixture(scope="module")
def stream():
    return encode_scene(tiny_scene(seed=2, num_anchors=500), Packetization(block_size=100))


@pytest.fixture(scope="module")
def data(stream):
    return calibration_data(stream, decode_stream(stream))


@pytest.fixture(scope="module")
def result(stream, data):
    return sketch_of(stream, data.complete, VIEWS, CONFIG)


@pytest.fixture(scope="module")
def material(data):
    return sketch_material(data.complete, render_sensitivity(data.scene, VIEWS.cameras, probes=4), 10**6)


def test_sketch_fits_its_byte_share_and_improves_quality(stream, result) -> None:
    assert len(result.section) <= 0.1 * stream.num_bytes
    assert result.num_sketched > 0
    assert (result.exponent,) in AnchorSketch.growth_candidates
    assert result.trust in AnchorSketch.trust_candidates
    assert result.psnr["no loss"] > result.psnr["sketch"] > max(result.psnr["grow"], result.psnr["drop"])


def test_the_same_seed_gives_the_same_bytes(stream, data, result) -> None:
    assert sketch_of(stream, data.complete, VIEWS, CONFIG).section == result.section


def test_stream_carries_the_sketch(stream, data, result) -> None:
    richer = with_section(stream, "sketch", result.section)
    lossy, _ = transmit(richer, parse_loss("bernoulli:0.4"), seed=1)
    received = decode_stream(lossy)
    drawn = conceal(received, "sketch")
    section = read_sketch(result.section, sizes_of(data.complete), buckets_of(data.complete))
    there = received.loss_mask.fully_received | section.levels > 0
    assert np.array_equal(drawn.hints.left_out, ~there)
    assert np.array_equal(
        drawn.anchors.features[received.loss_mask.fully_received],
        data.scene.anchors.features[received.loss_mask.fully_received],
    )


def test_more_bytes_lower_the_error_of_copies(data, material) -> None:
    """Error of the copies in the selection metric, relative to omitting the anchors."""
    nothing = data.complete.masked(np.zeros(500, np.bool_))
    errors, sizes = [], []
    for price in (1e-8, 1e-10, 1e-12):
        section = fit_sketch(material, price, SketchFit())
        sizes.append(len(write_sketch(section, buckets_of(data.complete))))
        copied = with_sketch(nothing, section)
        rows = section.levels > 0
        wrong = copied.scene.anchors.features[rows] - data.complete.scene.anchors.features[rows]
        errors.append(float((wrong**2).mean()))
    assert sizes == sorted(sizes)
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.05 * float(data.complete.scene.anchors.features.var())


def test_scalings_are_relative_to_the_prior(data, material) -> None:
    section = fit_sketch(material, 1e-13, SketchFit(num_levels=6))
    rows = np.flatnonzero(section.levels)
    true = data.complete.scene.anchors.scalings[rows]
    nothing = data.complete.masked(np.zeros(500, np.bool_))
    copied = with_sketch(nothing, section).scene.anchors.scalings[rows]
    assert float(np.median(np.abs(np.log(copied / true)))) < 0.2
    flat = sketched_attributes(section, np.ones((len(rows), 6), np.float32))[1]
    assert not np.allclose(flat, copied)


@pytest.mark.parametrize("make", [tiny_scene, tiny_causal_scene])
def test_pseudo_loss_equals_decoding_a_lossy_stream(make) -> None:
    """Positions that packets carry are estimated for lost anchors."""
    stream = encode_scene(make(seed=2, num_anchors=300), Packetization(block_size=100))
    lossy = decode_stream(transmit(stream, parse_loss("bernoulli:0.4"), seed=1)[0])
    pretended = calibration_data(stream, decode_stream(stream)).complete.masked(lossy.loss_mask.fully_received)
    for field in dataclasses.fields(lossy.scene.anchors):
        assert np.array_equal(getattr(pretended.scene.anchors, field.name), getattr(lossy.scene.anchors, field.name)), (
            field.name
        )
    assert np.array_equal(pretended.loss_mask.received, lossy.loss_mask.received)
    assert np.array_equal(pretended.positions, lossy.positions)


@pytest.mark.parametrize("make", [tiny_scene, tiny_causal_scene])
def test_copies_are_placed_at_the_lost_gaussians(make) -> None:
    stream = encode_scene(make(seed=2, num_anchors=300), Packetization(block_size=100))
    data = calibration_data(stream, decode_stream(stream))
    material = sketch_material(data.complete, render_sensitivity(data.scene, VIEWS.cameras, probes=4), 10**6)
    section = fit_sketch(material, 1e-15, SketchFit(num_levels=6))
    copied = with_sketch(data.complete.masked(np.zeros(300, np.bool_)), section).scene.anchors
    there, true = (section.levels > 0)[:, None] & copied.mask, data.complete.scene.anchors
    assert int(there.sum()) > 20
    assert bool((true.mask | ~there).all())

    def centers(anchors) -> np.ndarray:
        return (anchors.positions[:, None] + anchors.offsets * anchors.scalings[:, None, :3])[there]

    wrong = np.median(np.linalg.norm(centers(copied) - centers(true), axis=1))
    predicted = data.complete.get(PredictedPositions)
    moved = 0.1 * float(true.positions.std())
    if predicted is not None:
        moved = np.median(np.linalg.norm(true.positions - predicted.positions, axis=1))
    assert float(wrong) < 0.3 * float(moved)


def test_invalid_arguments_are_refused(stream, data) -> None:
    for field, value in (
        ("share", 0.9),
        ("drop_rate", 1.0),
        ("views", 0),
        ("seed", -1),
        ("num_losses", -1),
    ):
        with pytest.raises(InvalidValueError, match=field):
            SketchConfig(**{field: value})
    with pytest.raises(InvalidValueError, match="no sketch fits"):
        sketch_of(stream, data.complete, VIEWS, dataclasses.replace(CONFIG, share=20 / stream.num_bytes))
    away = dataclasses.replace(VIEWS.cameras, viewmats=VIEWS.cameras.viewmats.copy())
    away.viewmats[:, 2, 3] = -1e4
    with pytest.raises(InvalidValueError, match="no view shows anything"):
        sketch_of(stream, data.complete, CalibrationViews(away), CONFIG)


@pytest.mark.parametrize("width", [48, 31])
def test_masked_photo_pixels_do_not_change_the_sketch(stream, data, width) -> None:
    """Photos are tested at full and reduced size, where pixels at a mask border mix both sides."""
    pictures = render_scene(data.scene, VIEWS.cameras)
    mask = np.zeros((32, 48), np.bool_)
    mask[5:30, 3:36] = True
    config, found = dataclasses.replace(CONFIG, width=width, scored_views=3), []
    for garbage in (0.0, 1.0):
        photos = np.where(mask[..., None], pictures, np.full_like(pictures, garbage))
        photos[2] = pictures[2]
        views = CalibrationViews(VIEWS.cameras, photos.__getitem__, mask=lambda view: None if view == 2 else mask)
        found.append(sketch_of(stream, data.complete, views, config))
    whole = sketch_of(stream, data.complete, dataclasses.replace(views, mask=None), config)
    assert found[0].psnr == found[1].psnr != whole.psnr
    assert found[0].section == found[1].section
