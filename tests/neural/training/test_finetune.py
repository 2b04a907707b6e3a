"""Training of a finished scene with fixed anchors."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from scenes import tiny_causal_scene, tiny_scene
from splatwire.anchors.scene_file import load_scene, save_scene
from splatwire.cli.main import main
from splatwire.data import Dataset
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.neural.training import create_config
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.finetune import fine_tuning_config, state_of_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.step import TrainingStep
from splatwire.types import AnchorScene, Linear, Mlp
from splatwire.types.metadata import SceneMetadata

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def finished(dataset: Dataset, config: TrainConfig) -> AnchorScene:
    """A trained scene."""
    state, step = initial_state(dataset, config), TrainingStep(config, dataset.cameras)
    photo = prepare_photo(torch.from_numpy(dataset.image(1)))
    for _ in range(config.milestones.iterations):
        step(state, 1, photo)
    return export_scene(state, config)


def test_state_of_a_scene_exports_the_same_scene(dataset: Dataset, finished: AnchorScene) -> None:
    recipe = fine_tuning_config(create_config(iterations=30, packet_losses=("bernoulli:0.2",)), finished)
    assert (recipe.milestones.iterations, recipe.packet_loss.models) == (30, ("bernoulli:0.2",))
    again = export_scene(state_of_scene(finished, dataset, recipe), recipe)
    for name, value in vars(finished.anchors).items():
        found = getattr(again.anchors, name)
        assert np.allclose(found, value, rtol=1e-6) if name == "scalings" else np.array_equal(found, value), name
    old, new = finished.coding, again.coding
    assert (old.voxel_size, old.config) == (new.voxel_size, new.config)
    assert np.array_equal(old.context_model.grid.volume, new.context_model.grid.volume)
    assert np.array_equal(old.context_model.grid.planes, new.context_model.grid.planes)
    assert np.array_equal(old.context_model.channel[-1].output.weight, new.context_model.channel[-1].output.weight)
    assert np.array_equal(finished.heads.color.hidden.bias, again.heads.color.hidden.bias)


def test_finetuning_keeps_anchors_and_improves_pictures(
    dataset: Dataset, config: TrainConfig, finished: AnchorScene
) -> None:
    recipe = fine_tuning_config(config, finished)
    state, step = state_of_scene(finished, dataset, recipe), TrainingStep(recipe, dataset.cameras)
    photo = prepare_photo(torch.from_numpy(dataset.image(2)))
    found = [step(state, 2, photo).l1 for _ in range(40)]
    assert sum(found[-5:]) < sum(found[:5])
    kept = export_scene(state, recipe).anchors.positions
    assert {tuple(row) for row in kept.tolist()} <= {tuple(row) for row in finished.anchors.positions.tolist()}


def test_other_networks_are_refused(dataset: Dataset) -> None:
    scene = tiny_scene(num_anchors=50)
    opacity = scene.heads.opacity
    for wrong, message in (
        (Mlp(opacity.hidden, opacity.output, 0.2), "activation"),
        (Mlp(opacity.hidden, Linear(opacity.output.weight[:-1], opacity.output.bias[:-1])), "heads.opacity.output"),
    ):
        other = dataclasses.replace(scene, heads=dataclasses.replace(scene.heads, opacity=wrong))
        with pytest.raises(InvalidValueError, match=message):
            state_of_scene(other, dataset, fine_tuning_config(create_config(iterations=30), other))


def test_a_scene_in_other_coordinates_than_the_photos_is_refused(dataset: Dataset, finished: AnchorScene) -> None:
    recipe, origin = fine_tuning_config(create_config(iterations=30), finished), (500_000.0, 5_400_000.0, 300.0)
    georeferenced = dataclasses.replace(finished, origin=origin)
    with pytest.raises(DatasetError, match="training views see none of the anchors of the scene"):
        state_of_scene(georeferenced, dataset, recipe)
    cameras = dataclasses.replace(dataset.cameras, origin=origin)
    state = state_of_scene(georeferenced, dataclasses.replace(dataset, cameras=cameras, points=None), recipe)
    assert state.origin == origin


def test_finetune_command_runs(
    finished: AnchorScene, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start, output = tmp_path / "start.scene", tmp_path / "out.scene"
    metadata = SceneMetadata("Garden", license="CC0")
    save_scene(dataclasses.replace(finished, background=(0.0, 0.5, 0.0), metadata=metadata), start)
    words = ["train", folder, "-o", output, "--init", start, "--iterations", 20, "--json"]
    with pytest.raises(SystemExit) as stopped:
        main([*map(str, words), "--loss", "bernoulli:0.2", "gilbert:0.2,3"])
    assert stopped.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["recipe"]["losses"]["models"] == ["bernoulli:0.2", "gilbert:0.2,3"]
    assert report["recipe"]["background"] == [0.0, 0.5, 0.0]
    assert load_scene(output).anchors.num_anchors <= finished.anchors.num_anchors
    assert load_scene(output).metadata == metadata
    for option in (("--voxel-size", "0.1"), ("--loss-share", "0.5")):
        with pytest.raises(SystemExit) as stopped:
            main([*map(str, words), *option])
        assert stopped.value.code == 2
        assert option[0] in capsys.readouterr().err
    with pytest.raises(SystemExit) as stopped:
        main(["train", str(folder), "-o", str(start), "--init", str(start)])
    assert stopped.value.code == 2
    assert f"{start} is the input {start}, which would be lost" in capsys.readouterr().err


def test_format_1_scenes_are_finetuned_without_averaging() -> None:
    assert fine_tuning_config(create_config(model="hacpp"), tiny_scene()).averaging_iterations == 0
    assert (
        fine_tuning_config(create_config(), tiny_causal_scene()).averaging_iterations
        == create_config().averaging_iterations
        > 0
    )
