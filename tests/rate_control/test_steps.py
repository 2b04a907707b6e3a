"""Precision of each attribute, measured for one scene."""

from dataclasses import replace

import numpy as np
import pytest

from shells import shell
from splatwire.bitstream import SceneStream
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.layout import (
    STEP_BITS,
    STEP_COLOUR,
    STEP_DIRECTION,
    STEP_HARMONICS,
    STEP_POSITION,
    STEP_SPIN,
    STEPS,
)
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.errors import InvalidValueError
from splatwire.rate_control.steps import measured_colour_precision, measured_precision
from splatwire.rate_control.views import SourcePictures
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import measure_class_offsets
from splatwire.types import Cameras, SplatScene

AT = Quality(7.5)


def encode_plainly(some: SplatScene, classes: np.ndarray, quality: Quality) -> SceneStream:
    return encode_scene(some, class_offsets=classes, quality=quality)


def views(scene: SplatScene) -> Cameras:
    return surrounding_cameras(scene, 4, 128)


def measured(scene: SplatScene) -> np.ndarray:
    return np.array(measured_precision(scene, measure_class_offsets(scene.splats), AT, views(scene), encode_plainly))


def outcome(scene: SplatScene, quality: Quality) -> tuple[int, float]:
    """Bytes of a scene at a quality setting, and PSNR after rounding in decibels."""
    classes = measure_class_offsets(scene.splats)
    rounded = replace(scene, splats=round_splats(scene.splats, coding_for(scene.splats, quality, classes)))
    return encode_plainly(scene, classes, quality).num_bytes, SourcePictures(scene, views(scene)).mean_psnr(rounded)


def round_gaussians(scene: SplatScene) -> SplatScene:
    """The scene with equal standard deviations along all axes, and one colour."""
    splats = scene.splats
    scales = np.repeat(np.sort(splats.scales, axis=1)[:, 1:2], 3, axis=1)
    sh = np.repeat(splats.sh[:1], splats.num_gaussians, axis=0)
    return replace(scene, splats=replace(splats, scales=scales, sh=sh))


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1])
def test_measured_precision_takes_fewer_bytes_per_quality(degree):
    scene = shell(2000, degree)
    before, after = outcome(scene, AT), outcome(scene, replace(AT, precision=tuple(measured(scene).tolist())))
    assert after[0] < before[0] + (after[1] - before[1]) * before[0] / 100
    assert abs(after[1] - before[1]) < 3


def test_rotations_of_round_gaussians_become_coarse_and_a_single_colour_becomes_fine():
    octaves = measured(round_gaussians(shell(1000)))
    assert octaves[STEP_DIRECTION] == octaves[STEP_SPIN] == octaves.min() < -2
    assert octaves[STEP_COLOUR] > octaves[STEP_POSITION]


def colour_precision(scene: SplatScene) -> np.ndarray:
    classes = measure_class_offsets(scene.splats)
    return np.array(measured_colour_precision(scene, classes, AT, views(scene), encode_plainly))


def test_colour_precision_takes_fewer_bytes_per_quality():
    scene = shell(2000, 1)
    base, rest = np.split(scene.splats.sh, [1], axis=1)  # base colours that take nearly no bytes
    sh = np.concatenate([np.full_like(base, 0.3), rest / 4], axis=1)
    scene = replace(scene, splats=replace(scene.splats, sh=sh))
    octaves = colour_precision(scene)
    assert octaves[STEP_COLOUR] == octaves.sum() > 0
    before, after = outcome(scene, AT), outcome(scene, replace(AT, precision=tuple(octaves.tolist())))
    finer = outcome(scene, replace(AT, level=AT.level + 1))
    price = np.log(finer[0] / before[0]) / (finer[1] - before[1])
    assert np.log(after[0] / before[0]) < price * (after[1] - before[1])


def test_colours_stay_as_precise_if_harmonics_hide_their_rounding():
    scene = shell(1000, 1)
    base, rest = np.split(scene.splats.sh, [1], axis=1)
    loud = replace(scene, splats=replace(scene.splats, sh=np.concatenate([base, 40 * rest], axis=1)))
    assert not colour_precision(loud).any()


def test_scenes_without_harmonics_keep_their_precision():
    assert measured(shell(500))[STEP_HARMONICS] == 0


def test_measured_precision_is_repeatable():
    scene = shell(500)
    assert (measured(scene) == measured(scene)).all()


def test_an_octave_of_precision_halves_the_step_of_one_quantity():
    precision = np.arange(len(STEPS)) / 2
    finer = Quality(8.0, precision=tuple(precision.tolist())).base_exponents(0) - Quality(8.0).base_exponents(0)
    assert finer.tolist() == (precision * (1 << STEP_BITS)).tolist()


@pytest.mark.parametrize("precision", [(), (0.0,), (17.0,) * len(STEPS)])
def test_precision_of_wrong_length_or_range_is_refused(precision):
    with pytest.raises(InvalidValueError, match="9 numbers from -16 to 16"):
        Quality(precision=precision)
