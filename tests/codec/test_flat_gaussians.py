"""Flat disks, needles and points keep their shape and their share of the bits."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from close import unit
from splatwire.codec import decode_stream, encode_scene
from splatwire.render.precision import scene_class_offsets
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

TINY = float(np.exp(-60))
"""Size that readers assign to an axis of 0."""
FLATTEST = 0.004
"""Smallest ratio of neighbouring axes that a stream can represent after rounding of companded values."""


def ball(count: int = 500, seed: int = 8) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=unit(rng.normal(size=(count, 4)).astype(np.float32)),
        scales=(0.03 * np.exp(rng.normal(size=(count, 3)) * 0.4)).astype(np.float32),
        opacities=rng.uniform(0.4, 0.95, count).astype(np.float32),
        sh=rng.normal(size=(count, 1, 3)).astype(np.float32),
    )


def flattened(splats: Splats, share: float, axes: tuple[int, ...] = (2,)) -> tuple[Splats, np.ndarray]:
    """Gaussians with some axes of size zero, and the mask of those axes."""
    chosen = np.random.default_rng(0).random(splats.num_gaussians) < share
    scales = splats.scales.copy()
    for axis in axes:
        scales[chosen, axis] = TINY
    return dataclasses.replace(splats, scales=scales), chosen


def decoded(splats: Splats, quality: str) -> Splats:
    """Decoded Gaussians in the order of `splats`."""
    scene = SplatScene(splats)
    found = decode_stream(
        encode_scene(scene, quality=quality, class_offsets=scene_class_offsets(scene, recompute=True))
    ).scene.splats
    return found.select(cdist(splats.means, found.means).argmin(axis=1))


@pytest.mark.parametrize("quality", ["default", "near-lossless"])
@pytest.mark.parametrize("share", [1.0, 0.1, 0.004])
def test_decoded_flat_gaussians_are_flat(quality: str, share: float) -> None:
    splats, flat = flattened(ball(), share)
    low, middle, _ = np.sort(decoded(splats, quality).scales[flat], axis=1).T
    assert float((low / middle).max()) < FLATTEST


def test_flat_gaussians_of_the_smallest_quality_are_thin() -> None:
    splats, flat = flattened(ball(), 0.1)
    low, middle, _ = np.sort(decoded(splats, "small").scales[flat], axis=1).T
    assert float((low / middle).max()) < 0.05


@pytest.mark.parametrize("axes", [(2,), (1, 2)], ids=["disks", "needles"])
def test_a_missing_axis_makes_no_gaussian_less_precise(axes: tuple[int, ...]) -> None:
    splats, chosen = flattened(ball(), 0.1, axes)
    classes = scene_class_offsets(SplatScene(splats))
    assert classes is not None
    before = scene_class_offsets(SplatScene(ball()))
    assert before is not None
    change = (classes.astype(int) - before)[chosen]
    assert np.median(change) >= -2
    assert change.min() >= -5


@pytest.mark.parametrize("axes", [(2,), (1, 2), (0, 1, 2)], ids=["disks", "needles", "points"])
def test_flat_gaussians_do_not_change_precision_of_others(axes: tuple[int, ...]) -> None:
    splats, chosen = flattened(ball(), 0.1, axes)
    errors = []
    for scene in (splats, ball()):
        found = decoded(scene, "default")
        logs = (np.log(np.sort(found.scales, axis=1)) - np.log(np.sort(scene.scales, axis=1)))[~chosen]
        errors.append([float(np.abs(logs[:, 2]).mean()), float(np.abs((found.means - scene.means)[~chosen]).mean())])
    assert np.divide(errors[0], errors[1]).max() < 1.3
