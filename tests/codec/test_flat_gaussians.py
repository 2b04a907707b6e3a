"""Flat disks, needles and points keep their shape and their share of the bits."""

import dataclasses

import numpy as np
import pytest
import torch

from splatwire.codec import decode_stream, encode_scene
from splatwire.model import SplatScene
from splatwire.render.precision import classes_of
from splatwire.scene.splats import Splats

TINY = float(np.exp(-60))
"""Size that readers give to an axis of 0."""
FLATTEST = 0.004
"""Ratio of the smallest axis to the next one that a stream holds, with the rounding of its companded values."""


def ball(count: int = 500, seed: int = 8) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=torch.from_numpy(rng.uniform(-1, 1, (count, 3)).astype(np.float32)),
        quats=torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(count, 4)).astype(np.float32)), dim=1),
        scales=torch.from_numpy((0.03 * np.exp(rng.normal(size=(count, 3)) * 0.4)).astype(np.float32)),
        opacities=torch.from_numpy(rng.uniform(0.4, 0.95, count).astype(np.float32)),
        sh=torch.from_numpy(rng.normal(size=(count, 1, 3)).astype(np.float32)),
    )


def flattened(splats: Splats, share: float, axes: tuple[int, ...] = (2,)) -> tuple[Splats, torch.Tensor]:
    """Gaussians of which a share has no size along some axes, and which those are."""
    chosen = torch.rand(splats.num_gaussians, generator=torch.Generator().manual_seed(0)) < share
    scales = splats.scales.clone()
    for axis in axes:
        scales[chosen, axis] = TINY
    return dataclasses.replace(splats, scales=scales), chosen


def decoded(splats: Splats, quality: str) -> Splats:
    """Gaussians as a receiver has them, in the order of `splats`."""
    scene = SplatScene(splats)
    found = decode_stream(encode_scene(scene, quality=quality, classes=classes_of(scene, anew=True))).scene.splats
    return found.select(torch.cdist(splats.means, found.means).argmin(dim=1))


@pytest.mark.parametrize("quality", ["default", "near-lossless"])
@pytest.mark.parametrize("share", [1.0, 0.1, 0.004])
def test_flat_gaussians_stay_flat(quality: str, share: float) -> None:
    splats, flat = flattened(ball(), share)
    low, middle, _ = decoded(splats, quality).scales[flat].sort(dim=1).values.T
    assert float((low / middle).max()) < FLATTEST


def test_flat_gaussians_of_the_smallest_quality_are_thin() -> None:
    splats, flat = flattened(ball(), 0.1)
    low, middle, _ = decoded(splats, "small").scales[flat].sort(dim=1).values.T
    assert float((low / middle).max()) < 0.05


@pytest.mark.parametrize("axes", [(2,), (1, 2)], ids=["disks", "needles"])
def test_a_missing_axis_makes_no_gaussian_less_precise(axes: tuple[int, ...]) -> None:
    splats, chosen = flattened(ball(), 0.1, axes)
    classes = classes_of(SplatScene(splats))
    assert classes is not None
    before = classes_of(SplatScene(ball()))
    assert before is not None
    change = (classes.astype(int) - before)[chosen.numpy()]
    assert np.median(change) >= -2
    assert change.min() >= -5


@pytest.mark.parametrize("axes", [(2,), (1, 2), (0, 1, 2)], ids=["disks", "needles", "points"])
def test_others_are_as_precise_as_without_flat_ones(axes: tuple[int, ...]) -> None:
    splats, chosen = flattened(ball(), 0.1, axes)
    errors = []
    for scene in (splats, ball()):
        found = decoded(scene, "default")
        logs = (found.scales.sort(dim=1).values.log() - scene.scales.sort(dim=1).values.log())[~chosen]
        errors.append([float(logs[:, 2].abs().mean()), float((found.means - scene.means)[~chosen].abs().mean())])
    assert np.divide(errors[0], errors[1]).max() < 1.3
