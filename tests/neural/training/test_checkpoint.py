import dataclasses
import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from splatwire.data import Dataset
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import PacketLossConfig, TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.state import TrainState
from splatwire.neural.training.step import TrainingStep
from splatwire.types.metadata import SceneMetadata, StartView

pytestmark = pytest.mark.slow

LAST = 52
"""Iterations of a run without losses."""


def _train(state: TrainState, dataset: Dataset, config: TrainConfig, last: int) -> None:
    photos, step = PhotoStore(dataset, torch.device("cpu")), TrainingStep(config, dataset.cameras)
    while state.iteration < last:
        view = int(torch.randint(dataset.num_views, (1,), generator=state.generator))
        step(state, view, photos.photo(view))


def _tensors(state: TrainState) -> dict[str, torch.Tensor]:
    values = {name: value.detach() for name, value in state.parameters.items()}
    values |= {f"first.{name}": moments.first for name, moments in state.moments.items()}
    values |= {f"second.{name}": moments.second for name, moments in state.moments.items()}
    values |= {f"mean.{name}": value for name, value in state.parameter_means.items()}
    values |= vars(state.statistics) | {"voxels": state.voxels, "generator": state.generator.get_state()}
    return values | {"bounds_min": state.bounds_min, "bounds_max": state.bounds_max}


@pytest.fixture(scope="module")
def straight(dataset: Dataset, config: TrainConfig) -> TrainState:
    """State of an uninterrupted run without losses."""
    state = initial_state(dataset, config)
    _train(state, dataset, config, LAST)
    return state


@pytest.fixture(scope="module")
def saved(dataset: Dataset, config: TrainConfig, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A checkpoint with a trained context model."""
    path, state = tmp_path_factory.mktemp("saved") / "run.checkpoint", initial_state(dataset, config)
    _train(state, dataset, config, 38)
    save_checkpoint(state, config, path)
    return path.read_bytes()


@pytest.mark.parametrize(("pause", "losses"), [(5, ()), (30, ()), (45, ()), (53, ("bernoulli:0.3", "gilbert:0.3,3"))])
def test_resumed_run_equals_an_uninterrupted_run(
    pause: int, losses: tuple[str, ...], dataset: Dataset, config: TrainConfig, straight: TrainState, tmp_path: Path
) -> None:
    config = dataclasses.replace(config, packet_loss=PacketLossConfig(losses))
    last = LAST + 6 if losses else LAST
    if losses:
        straight = initial_state(dataset, config)
        _train(straight, dataset, config, last)
    interrupted = initial_state(dataset, config)
    _train(interrupted, dataset, config, pause)
    save_checkpoint(interrupted, config, tmp_path / "run.checkpoint")
    resumed, recipe = load_checkpoint(tmp_path / "run.checkpoint")
    assert recipe == config
    _train(resumed, dataset, recipe, last)
    expected, found = _tensors(straight), _tensors(resumed)
    assert expected.keys() == found.keys()
    assert straight.num_anchors != initial_state(dataset, config).num_anchors  # the run added or pruned anchors
    for name, value in expected.items():
        assert torch.equal(value, found[name]), name
    steps = {name: moments.steps for name, moments in straight.moments.items()}
    assert steps == {name: moments.steps for name, moments in resumed.moments.items()}


def test_metadata_of_a_finished_scene_survive_a_checkpoint(
    dataset: Dataset, config: TrainConfig, tmp_path: Path
) -> None:
    metadata = SceneMetadata(
        "Garden", author="Ada", license="CC0", view=StartView((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    )
    state = dataclasses.replace(initial_state(dataset, config), metadata=metadata)
    save_checkpoint(state, config, tmp_path / "run.checkpoint")
    resumed, recipe = load_checkpoint(tmp_path / "run.checkpoint")
    assert export_scene(resumed, recipe).metadata == metadata


def test_a_failed_save_leaves_the_old_checkpoint(
    dataset: Dataset, config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, state = tmp_path / "run.checkpoint", initial_state(dataset, config)
    save_checkpoint(state, config, path)
    before = path.read_bytes()

    def full(tensors: object, target: Path, metadata: object) -> None:
        Path(target).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("splatwire.anchors.tensor_file.save_file", full)
    with pytest.raises(OSError, match="No space"):
        save_checkpoint(state, config, path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.checkpoint"]


def test_other_files_are_refused_as_checkpoints(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> None:
    path, other = tmp_path / "run.checkpoint", tmp_path / "other"
    save_checkpoint(initial_state(dataset, config), config, path)
    with pytest.raises(BitstreamError, match="no such"):
        load_checkpoint(other)
    whole = path.read_bytes()
    for damaged in (b"", whole[:100], whole[: len(whole) // 2], b"\x00" * 200):
        other.write_bytes(damaged)
        with pytest.raises(BitstreamError):
            load_checkpoint(other)
    save_file({"x": torch.zeros(2)}, other)
    with pytest.raises(BitstreamError, match="not a file of splatwire-checkpoint"):
        load_checkpoint(other)
    other.write_bytes(whole.replace(b'\\"version\\": 5', b'\\"version\\": 9'))
    with pytest.raises(UnsupportedVersionError):
        load_checkpoint(other)


@pytest.mark.parametrize("name", ["parameters.features", "first.prior.hidden.bias", "generator", "statistics.visits"])
def test_missing_misshapen_and_infinite_tensors_are_refused(name: str, saved: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.checkpoint"
    path.write_bytes(saved)
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    whole = load_file(path)
    cases = [{k: v for k, v in whole.items() if k != name}, {**whole, name: whole[name][:1].clone()}]
    if whole[name].is_floating_point():
        cases.append({**whole, name: torch.full_like(whole[name], torch.nan)})
    for tensors in cases:
        save_file(tensors, path, metadata=metadata)
        with pytest.raises(BitstreamError, match="damaged"):
            load_checkpoint(path)
