import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from splatwire.data import Dataset
from splatwire.neural.training import Listener, RunOptions, load_checkpoint, train_scene
from splatwire.neural.training.averaging import averaging_start, update_means
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.fine_tuning_phase import start_fine_tuning
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import choose_kernels
from splatwire.neural.training.models import new_context_model
from splatwire.neural.training.packet_loss import PacketLossSimulator
from splatwire.neural.training.presets import packet_loss_config

pytestmark = pytest.mark.slow


def going_on(config: TrainConfig) -> TrainConfig:
    marks = dataclasses.replace(config.milestones, iterations=80, fine_tuning_iterations=20)
    return dataclasses.replace(
        config, milestones=marks, averaging_iterations=4, packet_loss=packet_loss_config(("bernoulli:0.3",))
    )


def test_state_at_the_start_of_fine_tuning_equals_its_exported_scene(dataset: Dataset, config: TrainConfig) -> None:
    config = going_on(config)
    state = initial_state(dataset, config)
    for value in (0.0, 0.1):
        state.iteration = averaging_start(config) + 1 + round(10 * value)
        for parameter in state.parameters.values():
            parameter.data.add_(value)
        update_means(state, config)
    state.parameter_means["mask_logits"][::3] = -20.0
    before = export_scene(state, config)
    start_fine_tuning(state, config)
    after = export_scene(state, config)
    assert not state.parameter_means
    assert not state.moments
    assert state.num_anchors == before.anchors.num_anchors < len(dataset.points.positions)
    assert np.array_equal(after.anchors.mask, before.anchors.mask)
    assert np.array_equal(after.anchors.features, before.anchors.features)
    assert np.array_equal(after.heads.color.hidden.weight, before.heads.color.hidden.weight)


def test_resumed_run_averages_only_its_own_iterations(config: TrainConfig) -> None:
    config = going_on(config)
    assert [averaging_start(config, iteration) for iteration in (1, 60, 61, 80)] == [52, 52, 72, 72]
    assert averaging_start(dataclasses.replace(config, averaging_iterations=50), 61) == 60


def test_resumed_run_resumes_after_another_stop(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> None:
    config, path, seen = going_on(config), tmp_path / "run.checkpoint", []
    listener = Listener(progress=seen.append, should_stop=lambda: len(seen) == 70)
    assert train_scene(dataset, None, config, options=RunOptions(checkpoint=path), listener=listener).stopped
    state, recipe = load_checkpoint(path)
    assert recipe == config
    resumed, straight = train_scene(dataset, None, recipe, state=state), train_scene(dataset, None, config)
    assert resumed.state.iteration == straight.state.iteration == 80
    assert np.array_equal(resumed.scene.anchors.features, straight.scene.anchors.features)


def test_losses_start_with_the_resumed_run_and_importance_from_its_middle(
    dataset: Dataset, config: TrainConfig
) -> None:
    config = going_on(config)
    state, kernels = initial_state(dataset, config), choose_kernels(torch.device("cpu"))
    for losses, begin in ((("bernoulli:0.3",), 60), (("bernoulli:0.3", "first:0.3"), 50)):
        recipe = dataclasses.replace(config, packet_loss=packet_loss_config(losses, 1.0))
        cache = AnchorCache(recipe)
        drawn = PacketLossSimulator(recipe, new_context_model(recipe, kernels, cache), cache)
        active = []
        for state.iteration in range(1, 81):
            active.append(drawn.active(state))
        assert active == [iteration > begin for iteration in range(1, 81)]
