"""The cost of harmonics follows the codec's quantisation, and makes fine-tuning set harmonics to 0."""

import numpy as np
import pytest

from close import assert_close
from shells import shell
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.finetuning import FineTuning, fitting_cameras, own_pictures, sparsity
from splatwire.finetuning.sparsity import HarmonicCost
from splatwire.finetuning.tune import tuned_gaussians
from splatwire.render import render_scene
from splatwire.types import SplatCoding, SplatScene

LEVELS = [-2.0, 5.0, 8.0, 20.0]


def _coded(scene: SplatScene, level: float) -> SplatCoding:
    classes = (-np.arange(scene.num_elements) % 4).astype(np.int8)
    return coding_for(scene.splats, Quality(level), classes)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rounded_coefficients_are_multiples_of_the_steps(level: float, degree: int) -> None:
    scene = shell(200, degree)
    coding = _coded(scene, level)
    cost = HarmonicCost.of(coding)
    rounded = round_splats(scene.splats, coding).sh[:, 1:].reshape(200, -1)
    numbers = rounded.astype(np.float64) @ cost.transform / cost.steps
    assert np.abs(numbers - np.rint(numbers)).max() < 0.02 + 1e-6 * np.abs(numbers).max()


@pytest.mark.parametrize("level", LEVELS)
def test_gradient_is_the_slope_of_the_cost(level: float) -> None:
    scene = shell(40, 2)
    cost, harmonics = HarmonicCost.of(_coded(scene, level)), scene.splats.sh[:, 1:].astype(np.float64)
    towards = np.random.Generator(np.random.PCG64(0)).normal(size=harmonics.shape)
    ahead, behind = (cost.value(harmonics + step * towards) for step in (1e-7, -1e-7))
    assert_close((ahead - behind) / 2e-7, np.sum(cost.gradient(harmonics) * towards), rtol=1e-3)


def test_harmonics_of_zero_cost_nothing_and_stay() -> None:
    scene = shell(40, 2)
    cost, zeros = HarmonicCost.of(_coded(scene, 7.0)), np.zeros((40, 8, 3), np.float32)
    assert cost.value(zeros) == 0
    assert (cost.gradient(zeros) == 0).all()


@pytest.mark.slow
def test_fine_tuning_saves_the_bytes_of_harmonics(monkeypatch: pytest.MonkeyPatch) -> None:
    source = shell(300, 2)
    classes, options = np.zeros(300, np.int8), FineTuning(Quality(level=5.0), iterations=150)
    pictures, sizes, errors = own_pictures(source, fitting_cameras(source, 8, 32)), [], []
    for weight in (0.0, sparsity.WEIGHT):
        monkeypatch.setattr(sparsity, "WEIGHT", weight)
        tuned = tuned_gaussians(source, pictures, options, class_offsets=classes).rounded
        sizes.append(encode_scene(tuned).num_bytes)
        errors.append(np.square(render_scene(tuned, pictures.cameras) - pictures.images / 255).mean())
    assert sizes[1] < 0.96 * sizes[0]
    assert errors[1] < 2 * errors[0]
