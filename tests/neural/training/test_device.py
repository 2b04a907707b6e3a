"""Training on a device: the same iterations in plain torch around a fake gsplat."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import fake_gsplat
from fake_device import DEVICE, FakeDeviceTensor, fake_device
from neural.training.conftest import photographed
from scenes import SMALL_CAUSAL
from splatwire.data import Dataset
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.render.gsplat_backend import GsplatRenderer
from splatwire.neural.training import Listener, Progress, RunOptions, load_checkpoint, train_scene
from splatwire.neural.training.config import Milestones, TrainConfig
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import COMPILED, HOST_RANDOMNESS, Kernels, plain_kernels
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.plain import prepare_photo_plain
from splatwire.neural.training.state import TrainState, move_state
from splatwire.neural.training.step import StepReport, TrainingStep
from splatwire.ops.arrays import to_arrays

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Photos of a quarter of the usual pixels, because the fake gsplat is slow."""
    return photographed(tmp_path_factory.mktemp("photos"), 24, 16)


@pytest.fixture
def gsplat(monkeypatch: pytest.MonkeyPatch) -> GsplatRenderer:
    """The gsplat renderer with a fake gsplat."""
    monkeypatch.setitem(sys.modules, "gsplat", fake_gsplat.module())
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    return GsplatRenderer()


@pytest.fixture
def plain(gsplat: GsplatRenderer) -> Kernels:
    """Training operations for a GPU with the random numbers of the CPU, so that runs are comparable."""
    return plain_kernels(gsplat.draw, HOST_RANDOMNESS)


def _run(state: TrainState, dataset: Dataset, config: TrainConfig, kernels: Kernels, count: int) -> list[StepReport]:
    step = TrainingStep(config, dataset.cameras, kernels)
    photos = [prepare_photo(torch.from_numpy(dataset.image(view))) for view in range(3)]
    return [step(state, i % 3, photos[i % 3]) for i in range(state.iteration, state.iteration + count)]


def _short(config: TrainConfig) -> TrainConfig:
    """All phases in 16 iterations with few anchors, because the fake gsplat is slow."""
    marks = Milestones(
        iterations=16, noise_start=7, growth_pause_end=8, context_start=11, statistics_start=1, growth_start=2,
        growth_end=14, growth_interval=4,
    )  # fmt: skip
    return dataclasses.replace(config, milestones=marks, growth=dataclasses.replace(config.growth, max_anchors=220))


def _copy(state: TrainState) -> TrainState:
    generator = torch.Generator()
    generator.set_state(state.generator.get_state())
    return dataclasses.replace(_moved(state, torch.device("meta")), generator=generator)


def _moved(state: TrainState, device: torch.device) -> TrainState:
    with fake_device():
        return move_state(move_state(state, device), torch.device("cpu"))


def _gradients(state: TrainState) -> dict[str, torch.Tensor]:
    """Gradients of a state, filled by the next backward pass."""
    found: dict[str, torch.Tensor] = {}
    for name, value in state.parameters.items():
        value.register_hook(lambda gradient, name=name: found.__setitem__(name, gradient.clone()))
    return found


@pytest.mark.parametrize("iterations", [3, 25, 45])  # pictures only; fixed noise; adaptive noise and rate
@pytest.mark.parametrize("model", ["hacpp", "causal"])
def test_device_iteration_equals_the_compiled_kernels(
    model: str, iterations: int, dataset: Dataset, config: TrainConfig, plain: Kernels
) -> None:
    config = config if model == "hacpp" else dataclasses.replace(config, model=SMALL_CAUSAL, mask_threshold=0.1)
    state = initial_state(dataset, config)
    _run(state, dataset, config, COMPILED, iterations)
    other = _copy(state)
    statistics = {name: rows.clone() for name, rows in vars(state.statistics).items()}
    expected, found = _gradients(state), _gradients(other)
    (report,) = _run(state, dataset, config, COMPILED, 1)
    (own,) = _run(other, dataset, config, plain, 1)
    assert own.num_gaussians == report.num_gaussians > 50
    assert own.loss == pytest.approx(report.loss, rel=1e-4)
    assert own.l1 == pytest.approx(report.l1, rel=1e-4)
    assert own.bits_per_anchor == (None if report.bits_per_anchor is None else pytest.approx(report.bits_per_anchor))
    assert (report.bits_per_anchor is not None) == (iterations > 40)
    assert found.keys() == expected.keys()
    for name, gradient in expected.items():
        assert float(gradient.abs().max()) > 0, name
        off = (found[name] - gradient).norm() / gradient.norm()
        assert float(off) < 2e-3, name
    for name, rows in vars(state.statistics).items():
        assert not torch.equal(rows, statistics[name]), name
        torch.testing.assert_close(vars(other.statistics)[name], rows, rtol=5e-3, atol=1e-6, msg=name)
    assert torch.equal(other.generator.get_state(), state.generator.get_state())


def test_device_growth_equals_the_compiled_kernels(dataset: Dataset, config: TrainConfig, plain: Kernels) -> None:
    states = [initial_state(dataset, config) for _ in range(2)]
    reports = [_run(s, dataset, config, k, 14) for s, k in zip(states, (COMPILED, plain), strict=True)]
    compiled, own = (torch.tensor([report.loss for report in run]) for run in reports)
    torch.testing.assert_close(own, compiled, rtol=0.05, atol=0)
    assert states[0].num_anchors > 250  # 200 at the start
    assert states[1].num_anchors == pytest.approx(states[0].num_anchors, rel=0.05)


def test_device_run_mixes_no_cpu_tensors(
    dataset: Dataset, config: TrainConfig, gsplat: GsplatRenderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels, config = plain_kernels(gsplat.draw, HOST_RANDOMNESS), _short(config)
    options = RunOptions(tmp_path / "run.checkpoint", checkpoint_interval=7, test_interval=8)
    test = dataset.select([2])
    reference = train_scene(dataset, test, config)
    monkeypatch.setattr("splatwire.neural.training.trainer.choose_kernels", lambda device: kernels)
    monkeypatch.setattr("splatwire.neural.training.loop.create_renderer", lambda name: _drawn_by(gsplat, name))
    with fake_device():
        result = train_scene(dataset, test, config, options=options, device=str(DEVICE))
    assert result.state.iteration == 16
    assert result.state.num_anchors > 205  # 200 at the start
    assert all(isinstance(value, FakeDeviceTensor) for value in result.state.parameters.values())
    assert isinstance(result.scene.anchors.features, np.ndarray)
    assert result.test is not None
    assert reference.test is not None
    assert result.test.psnr == pytest.approx(reference.test.psnr, abs=0.5)
    assert isinstance(result.test.preview, np.ndarray)
    state, recipe = load_checkpoint(tmp_path / "run.checkpoint")
    assert (state.iteration, recipe) == (16, config)
    assert state.device.type == "cpu"


def _drawn_by(gsplat: GsplatRenderer, name: str) -> object:
    assert name == "gsplat"

    def draw(gaussians: object, cameras: object, *, background: torch.Tensor) -> np.ndarray:
        gaussians, cameras = to_tensors((gaussians, cameras), DEVICE)
        picture = gsplat._rasterize(gaussians, cameras, to_tensors(background, DEVICE))[0]
        assert isinstance(picture, FakeDeviceTensor)
        return to_arrays(picture)

    return draw


def test_run_resumes_on_another_device(
    dataset: Dataset, config: TrainConfig, plain: Kernels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "splatwire.neural.training.trainer.choose_kernels", lambda device: COMPILED if device.type == "cpu" else plain
    )
    path, config = tmp_path / "run.checkpoint", _short(config)
    news: list[Progress] = []

    def part(device: str, until: int, state: TrainState | None) -> TrainState:
        listener = Listener(progress=news.append, should_stop=lambda: news[-1].iteration == until)
        with fake_device():
            train_scene(dataset, None, config, state=state, options=RunOptions(path), listener=listener, device=device)
        return load_checkpoint(path)[0]

    state = part("cpu", 9, part(str(DEVICE), 5, None))
    assert part(str(DEVICE), 12, state).iteration == 12
    assert [now.iteration for now in news] == list(range(1, 13))
    assert news[-1].loss < news[0].loss


def test_photos_beyond_device_memory_stay_on_the_host(dataset: Dataset) -> None:
    pixels = dataset.cameras.width * dataset.cameras.height
    with fake_device():
        store = PhotoStore(dataset, DEVICE, prepare_photo_plain, device_bytes=3 * pixels * 3)
        assert [isinstance(b, FakeDeviceTensor) for b in store._bytes] == [True] * 3 + [False] * 5
        photos = [store.photo(view).image.cpu() for view in (1, 6)]
    expected = PhotoStore(dataset, torch.device("cpu"))
    for view, photo in zip((1, 6), photos, strict=True):
        assert torch.equal(photo, expected.photo(view).image)


def test_empty_view_is_trained_without_error(dataset: Dataset, config: TrainConfig, plain: Kernels) -> None:
    away = dataset.cameras.viewmats.copy()
    away[:, [0, 2]] *= -1
    cameras = dataclasses.replace(dataset.cameras, viewmats=away)
    state = initial_state(dataset, config)
    before = {name: value.detach().clone() for name, value in state.parameters.items()}
    for _ in range(config.milestones.statistics_start + 1):
        photo = prepare_photo(torch.from_numpy(dataset.image(0)))
        assert TrainingStep(config, cameras, plain)(state, 0, photo).num_gaussians == 0
    assert all(torch.equal(before[name], value.detach()) for name, value in state.parameters.items())
