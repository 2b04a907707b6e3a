"""Trainings of explicit Gaussians on a tiny dataset."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import fake_gsplat
from fake_device import DEVICE, fake_device
from neural.training.conftest import NUM_VIEWS
from splat_io.formats.test_origin import UTM
from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import Dataset
from splatwire.errors import BitstreamError, DatasetError, DivergedError, InvalidValueError
from splatwire.io import open_scene, save_scene
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.render.differentiable import draw_cpu
from splatwire.neural.render.gsplat_backend import GsplatRenderer
from splatwire.neural.training import Listener, RunOptions
from splatwire.neural.training.gaussians import (
    GaussianConfig,
    GaussianResult,
    load_gaussian_checkpoint,
    save_gaussian_checkpoint,
    train_gaussians,
)
from splatwire.neural.training.gaussians.checkpoint import FORMAT, VERSION
from splatwire.neural.training.gaussians.config import GaussianRates
from splatwire.neural.training.gaussians.initial import initial_gaussians
from splatwire.neural.training.gaussians.step import GaussianStep, seen_gaussians
from splatwire.neural.training.kernels import COMPILED, HOST_RANDOMNESS, plain_kernels
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.quality import assess_scene
from splatwire.neural.training.state import Moments
from splatwire.render.base import Drawing
from splatwire.types import Gaussians, SplatScene
from splatwire.types.background import BLACK

CONFIG = GaussianConfig(gaussians=150, iterations=60, fine_tuning_iterations=20)


def same(first: SplatScene, second: SplatScene) -> bool:
    """True if two scenes have the same bytes."""
    return all(np.array_equal(value, getattr(second.splats, name)) for name, value in vars(first.splats).items())


@pytest.fixture(scope="module")
def uninterrupted(dataset: Dataset) -> GaussianResult:
    return train_gaussians(dataset, None, CONFIG)


def test_colours_equal_those_of_the_renderer(dataset: Dataset) -> None:
    state = initial_gaussians(dataset, CONFIG)
    with torch.no_grad():
        for value in state.parameters.values():
            value += 0.2 * torch.randn(value.shape, generator=state.generator)
    scene = state.scene(3, BLACK)
    center = dataset.cameras.centers[2]
    ours = seen_gaussians(state.parameters, 3, torch.from_numpy(center))
    theirs = scene.splats.seen_from(center)
    for name, value in vars(theirs).items():
        np.testing.assert_allclose(getattr(ours, name).detach().numpy(), value, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("with_points", [True, False])
def test_held_out_views_improve(dataset: Dataset, with_points: bool) -> None:
    train, test = dataset.select([0, 1, 2, 4, 5, 6]), dataset.select([3, 7])
    if not with_points:
        train = dataclasses.replace(train, points=None)
    config = GaussianConfig(
        gaussians=400, iterations=300, fine_tuning_iterations=80, rates=GaussianRates().for_length(300)
    )
    before = assess_scene(initial_gaussians(train, config).scene(3, BLACK), test, 2, 0).psnr
    result = train_gaussians(train, test, config)
    assert result.test is not None
    assert result.test.psnr > before + 3
    assert result.state.num_gaussians == 400


@pytest.mark.slow
def test_a_geo_referenced_training_equals_a_local_one(
    dataset: Dataset, uninterrupted: GaussianResult, tmp_path: Path
) -> None:
    assert dataset.points is not None
    cameras = dataclasses.replace(dataset.cameras, origin=UTM)
    points = dataclasses.replace(dataset.points, origin=UTM)
    there = dataclasses.replace(dataset, cameras=cameras, points=points)
    result = train_gaussians(there, there, CONFIG, options=RunOptions(tmp_path / "a.checkpoint", 30))
    assert result.scene.origin == result.state.origin == UTM
    assert same(result.scene, uninterrupted.scene)
    assert result.test is not None
    assert result.test.psnr == pytest.approx(assess_scene(uninterrupted.scene, dataset, NUM_VIEWS, 0).psnr, abs=1e-3)
    state, config = load_gaussian_checkpoint(tmp_path / "a.checkpoint")
    assert state.origin == UTM
    moved = dataclasses.replace(there, cameras=cameras.relative_to((UTM[0] + 2, UTM[1], UTM[2] - 1)))
    resumed = train_gaussians(moved, None, config, state=state)
    assert resumed.scene.origin == UTM
    assert np.abs(resumed.scene.splats.means - result.scene.splats.means).max() < 1e-3


def test_points_of_another_origin_than_the_cameras_are_moved(dataset: Dataset) -> None:
    assert dataset.points is not None
    cameras = dataclasses.replace(dataset.cameras, origin=UTM)
    points = dataclasses.replace(dataset.points, origin=UTM).relative_to((UTM[0] - 16, UTM[1] + 8, UTM[2]))
    state = initial_gaussians(dataclasses.replace(dataset, cameras=cameras, points=points), CONFIG)
    expected = initial_gaussians(dataset, CONFIG).parameters["means"].detach()
    assert torch.allclose(state.parameters["means"], expected, atol=1e-5)


def test_trained_gaussians_are_encoded_without_loss(uninterrupted: GaussianResult, tmp_path: Path) -> None:
    scene = uninterrupted.scene
    decoded = decode_stream(encode_scene(scene)).scene
    order = np.lexsort(scene.splats.means.T)
    assert np.allclose(decoded.splats.means[np.lexsort(decoded.splats.means.T)], scene.splats.means[order])
    save_scene(scene, tmp_path / "a.ply")
    assert encode_scene(open_scene(tmp_path / "a.ply")).num_bytes == encode_scene(scene).num_bytes


@pytest.mark.slow
def test_equal_seeds_give_equal_gaussians(dataset: Dataset, uninterrupted: GaussianResult) -> None:
    assert same(uninterrupted.scene, train_gaussians(dataset, None, CONFIG).scene)
    other = train_gaussians(dataset, None, dataclasses.replace(CONFIG, seed=1))
    assert not same(uninterrupted.scene, other.scene)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [7, 30, 65])
def test_resumed_training_equals_an_uninterrupted_one(
    dataset: Dataset, uninterrupted: GaussianResult, stop: int, tmp_path: Path
) -> None:
    """The last stop is in the fine-tuning."""
    path, calls = tmp_path / "run.checkpoint", []

    def should_stop() -> bool:
        calls.append(0)
        return len(calls) == stop

    stopped = train_gaussians(
        dataset, None, CONFIG, options=RunOptions(checkpoint=path), listener=Listener(should_stop=should_stop)
    )
    assert stopped.stopped
    state, config = load_gaussian_checkpoint(path)
    assert config == CONFIG
    assert state.iteration == min(stop, 60)
    resumed = train_gaussians(dataset, None, config, state=state)
    assert not resumed.stopped
    assert same(resumed.scene, uninterrupted.scene)


@pytest.mark.slow
def test_losses_change_the_fine_tuning_only(dataset: Dataset, uninterrupted: GaussianResult) -> None:
    lossy = train_gaussians(dataset, None, dataclasses.replace(CONFIG, packet_loss="bernoulli:0.4"))
    assert not same(lossy.scene, uninterrupted.scene)
    for name, value in uninterrupted.state.parameters.items():
        assert torch.equal(value, lossy.state.parameters[name])


def test_dropout_leaves_out_its_share_and_keeps_the_mean_opacity(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[torch.Tensor] = []

    def draw(gaussians: Gaussians, *words: Any, **named: Any) -> Drawing:
        drawn.append(gaussians.opacities.detach())
        return draw_cpu(gaussians, *words, **named)

    config = dataclasses.replace(CONFIG, gaussians=200, dropout=0.3)
    state, photos = initial_gaussians(dataset, config), PhotoStore(dataset, torch.device("cpu"))
    step = GaussianStep(config, dataset.cameras, dataclasses.replace(COMPILED, draw=draw))
    for view in range(8):
        state.iteration = 0  # before Gaussians are moved
        state.parameters["logits"] = torch.full_like(state.parameters["logits"], 0.0).requires_grad_()
        step(state, view, photos.photo(view))
    found = torch.stack(drawn)
    assert float((found == 0).float().mean()) == pytest.approx(0.3, abs=0.05)
    assert float(found.mean()) == pytest.approx(0.5, rel=0.05)
    assert len({tuple(row.tolist()) for row in found}) == 8


def test_degree_limits_the_harmonics(dataset: Dataset) -> None:
    result = train_gaussians(dataset, None, dataclasses.replace(CONFIG, degree=1))
    assert result.scene.splats.degree == 1
    assert "harmonics.2" not in result.state.parameters
    assert float(result.state.parameters["harmonics.1"].detach().abs().max()) > 0
    assert [CONFIG.degree_at(i) for i in (1, 6, 7, 13, 19, 60)] == [0, 0, 1, 2, 3, 3]


@pytest.mark.slow
def test_plain_kernels_with_gsplat_give_the_same_steps(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """The operations of a GPU, on a simulated device that refuses tensors of the CPU."""
    monkeypatch.setitem(__import__("sys").modules, "gsplat", fake_gsplat.module())
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    config = dataclasses.replace(CONFIG, iterations=20, degree=2, gaussians=260)
    compiled = initial_gaussians(dataset, config)
    photos, step = PhotoStore(dataset, torch.device("cpu")), GaussianStep(config, dataset.cameras)
    for view in range(6):
        step(compiled, view, photos.photo(view))
    with fake_device():
        kernels = plain_kernels(GsplatRenderer().draw, HOST_RANDOMNESS)
        state = initial_gaussians(dataset, config).moved(DEVICE)
        photos = PhotoStore(dataset, DEVICE, kernels.prepare_photo)
        step = GaussianStep(config, to_tensors(dataset.cameras, DEVICE), kernels)
        for view in range(6):
            step(state, view, photos.photo(view))
        assert state.device == DEVICE
        found = state.scene(2, BLACK).splats
    wanted = compiled.scene(2, BLACK).splats
    assert found.num_gaussians == wanted.num_gaussians > 200
    assert float(np.median(np.abs(found.means - wanted.means))) < 1e-3
    assert float(np.median(np.abs(found.sh - wanted.sh))) < 1e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gaussians": 0}, "1 to 4,000,000 Gaussians, not 0"),
        ({"degree": 4}, "degree 0 to 3, not 4"),
        ({"iterations": 19}, "20 iterations or more, not 19"),
        ({"seed": -1}, "0 or more, not -1"),
        ({"dropout": 1.0}, "below 1, not 1"),
        ({"packet_loss": "bernoulli:2"}, "share from 0 to 1, not 2"),
        ({"packet_loss": "bernoulli:0.2", "fine_tuning_iterations": 0}, "fine-tuning"),
    ],
)
def test_invalid_configurations_are_errors(options: dict, message: str) -> None:
    with pytest.raises(InvalidValueError, match=message):
        GaussianConfig(**options)


def test_checkpoints_contain_only_finite_moments(dataset: Dataset, tmp_path: Path) -> None:
    state = initial_gaussians(dataset, CONFIG)
    rows = torch.full_like(state.parameters["means"].detach(), torch.inf)
    state.moments["means"] = Moments(torch.zeros_like(rows), rows, 1)
    with pytest.raises(DivergedError, match=r"'second\.means' is not finite"):
        save_gaussian_checkpoint(state, CONFIG, tmp_path / "run.checkpoint")
    assert not list(tmp_path.iterdir())


def test_damaged_checkpoint_is_an_error(dataset: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "run.checkpoint"
    state = initial_gaussians(dataset, CONFIG)
    save_gaussian_checkpoint(state, CONFIG, path)
    tensors, header = read_tensors(path, FORMAT, VERSION)
    means = tensors["parameters.means"].copy()
    means[3] = np.nan
    write_tensors({**tensors, "parameters.means": means}, header, path)
    with pytest.raises(BitstreamError, match="means"):
        load_gaussian_checkpoint(path)
    path.write_bytes(b"nothing")
    with pytest.raises(BitstreamError, match="splatwire-gaussian-checkpoint"):
        load_gaussian_checkpoint(path)


def test_unusable_data_are_errors(dataset: Dataset) -> None:
    with pytest.raises(DatasetError, match="at least 2 views"):
        train_gaussians(dataset.select([0]), None, CONFIG)
    state = initial_gaussians(dataset, CONFIG)
    with torch.no_grad():
        state.parameters["base"][:] = torch.nan
    with pytest.raises(DivergedError):
        train_gaussians(dataset, None, CONFIG, state=state)
