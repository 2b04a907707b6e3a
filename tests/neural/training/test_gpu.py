"""Training on a real GPU, where one exists; `test_device` covers the rest."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gpu import DEVICE, NEEDS_GPU
from splatwire.data import Dataset
from splatwire.neural.training import RunOptions, export_scene, load_checkpoint, train_scene
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import HOST_RANDOMNESS, choose_kernels
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.quality import assess_scene
from splatwire.neural.training.state import TrainState, move_state
from splatwire.neural.training.step import StepReport, TrainingStep

pytestmark = [*NEEDS_GPU, pytest.mark.slow]


def _next(state: TrainState, dataset: Dataset, config: TrainConfig) -> tuple[StepReport, dict[str, torch.Tensor]]:
    """Gradients of the next iteration on the device of the state, with the random numbers of the CPU."""
    found: dict[str, torch.Tensor] = {}
    for name, value in state.parameters.items():
        value.register_hook(lambda gradient, name=name: found.__setitem__(name, gradient.cpu()))
    kernels = dataclasses.replace(choose_kernels(state.device), random=HOST_RANDOMNESS)
    photo = PhotoStore(dataset, state.device, kernels.prepare_photo).photo(1)
    cameras = dataset.cameras
    cameras = dataclasses.replace(cameras, viewmats=cameras.viewmats.to(state.device), Ks=cameras.Ks.to(state.device))
    return TrainingStep(config, cameras, kernels)(state, 1, photo), found


@pytest.mark.parametrize("iterations", [3, 25, 45])  # pictures only; fixed noise; adaptive noise and rate
def test_gpu_iteration_equals_the_cpu(iterations: int, dataset: Dataset, config: TrainConfig) -> None:
    state, step = initial_state(dataset, config), TrainingStep(config, dataset.cameras)
    for _ in range(iterations):
        step(state, 1, prepare_photo(torch.from_numpy(dataset.image(1))))
    generator = torch.Generator()
    generator.set_state(state.generator.get_state())
    other = dataclasses.replace(move_state(state, torch.device(DEVICE)), generator=generator)
    expected, gradients = _next(state, dataset, config)
    report, found = _next(other, dataset, config)
    assert report.num_gaussians == pytest.approx(expected.num_gaussians, rel=0.01)
    assert report.loss == pytest.approx(expected.loss, rel=5e-3)
    bits = expected.bits_per_anchor
    assert report.bits_per_anchor == (None if bits is None else pytest.approx(bits, rel=1e-3))
    assert found.keys() == gradients.keys()
    for name, gradient in gradients.items():
        assert float((found[name] - gradient).norm() / gradient.norm()) < 0.1, name
    for name, rows in vars(state.statistics).items():
        assert float((vars(other.statistics)[name].cpu() - rows).norm() / rows.norm()) < 0.05, name


def test_gpu_run_improves_pictures_and_resumes_on_the_cpu(
    dataset: Dataset, config: TrainConfig, tmp_path: Path
) -> None:
    growth = dataclasses.replace(config.growth, gradient_threshold=2e-4)
    config = dataclasses.replace(config, milestones=config.milestones.scaled(200), growth=growth)
    train, test = dataset.select([0, 1, 2, 4, 5, 6]), dataset.select([3, 7])
    before = assess_scene(export_scene(initial_state(train, config), config), train, 6, 0).psnr
    path = tmp_path / "run.checkpoint"
    result = train_scene(train, test, config, options=RunOptions(path, 90, 100), device=DEVICE)
    assert result.test is not None
    assert result.state.device.type == torch.device(DEVICE).type
    after = assess_scene(result.scene, train, 6, 200)  # with the CPU renderer
    assert after.psnr > before + 3
    state, recipe = load_checkpoint(path)
    again = train_scene(train, None, recipe, state=state)  # no iterations are left, which works on the CPU
    assert np.array_equal(again.scene.anchors.features, result.scene.anchors.features)
