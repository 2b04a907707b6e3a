import dataclasses

import pytest
import torch

from close import assert_close
from splatwire.data import Dataset
from splatwire.neural.training.averaging import averaging_start, update_means, with_averaged_parameters
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.state import keep_anchors
from splatwire.neural.training.step import TrainingStep

pytestmark = pytest.mark.slow


def test_parameter_average_is_uniform_then_exponential(dataset: Dataset, config: TrainConfig) -> None:
    config = dataclasses.replace(config, averaging_iterations=3)
    state = initial_state(dataset, config)
    values = torch.tensor([5.0, 1.0, 6.0, 10.0])
    expected = [5.0, 3.0, 4.0, 6.0]  # the last: 4 + (10 - 4) / 3
    for step, (value, mean) in enumerate(zip(values, expected, strict=True), 1):
        state.iteration = averaging_start(config) + step
        for parameter in state.parameters.values():
            parameter.data.fill_(float(value))
        update_means(state, config)
        assert state.parameter_means.keys() == state.parameters.keys()
        for name, found in state.parameter_means.items():
            torch.testing.assert_close(found, torch.full_like(found, mean), msg=name)
    for name, parameter in with_averaged_parameters(state).parameters.items():
        assert parameter is state.parameter_means[name]


@pytest.mark.parametrize("length", [0, 4])
def test_run_exports_the_average_of_its_last_iterations(length: int, dataset: Dataset, config: TrainConfig) -> None:
    config = dataclasses.replace(config, averaging_iterations=length)
    state, photos, history = initial_state(dataset, config), PhotoStore(dataset, torch.device("cpu")), []
    step = TrainingStep(config, dataset.cameras)
    while state.iteration < averaging_start(config) + 4:
        step(state, state.iteration % dataset.num_views, photos.photo(state.iteration % dataset.num_views))
        history.append(state.parameters["heads.opacity.output.bias"].detach().clone())
    kept = history[-length:] if length else history[-1:]
    assert_close(export_scene(state, config).heads.opacity.output.bias, torch.stack(kept).mean(dim=0))


def test_averaging_does_not_start_early(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)
    state.iteration = averaging_start(config)
    assert averaging_start(config) >= config.milestones.growth_end
    update_means(state, config)
    assert not state.parameter_means
    assert with_averaged_parameters(state) is state


def test_removed_anchors_are_removed_from_averages(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)
    state.iteration = averaging_start(config) + 1
    update_means(state, config)
    keep = torch.arange(state.num_anchors) % 2 == 0
    keep_anchors(state, keep)
    update_means(state, config)
    assert state.parameter_means["offsets"].shape == state.parameters["offsets"].shape
