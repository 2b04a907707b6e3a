"""Anchors are ordered by importance, and the most important ones may be received alone."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from splatwire.data import Dataset
from splatwire.neural.training.config import PacketLossConfig, TrainConfig
from splatwire.neural.training.context import AnchorCache
from splatwire.neural.training.hacpp import TrainableHacpp
from splatwire.neural.training.importance import importance_of, sort_by_importance
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import COMPILED
from splatwire.neural.training.packet_loss import PacketLossSimulator, ReceivedAnchors
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.state import TrainState
from splatwire.neural.training.step import TrainingStep
from splatwire.types.importance import Importance

pytestmark = pytest.mark.slow


@pytest.fixture
def state(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> TrainState:
    """A state with all anchors visible and some offsets masked out."""
    state, step = initial_state(dataset, config), TrainingStep(config, dataset.cameras)
    for view in range(6):
        step(state, view, prepare_photo(torch.from_numpy(dataset.image(view))))
    with torch.no_grad():
        logits = state.parameters["mask_logits"]
        logits[torch.rand(logits.shape, generator=torch.Generator().manual_seed(0)) < 0.3] = -20
        logits[:, 0] = 1
    return state


def test_anchors_are_reordered_with_all_their_state(state: TrainState, config: TrainConfig) -> None:
    share = np.random.default_rng(1).random(state.num_anchors)
    rows = {tuple(v): (f.tolist(), float(s)) for v, f, s in zip(
        state.voxels.tolist(), state.parameters["features"].detach(), share, strict=True)}  # fmt: skip
    sort_by_importance(state, Importance.of_footprints(share))
    found = [rows[tuple(v)] for v in state.voxels.tolist()]
    assert [f for f, _ in found] == state.parameters["features"].tolist()
    assert [s for _, s in found] == sorted((s for _, s in found), reverse=True)


def test_first_share_of_anchors_is_received(state: TrainState, dataset: Dataset, config: TrainConfig) -> None:
    losses = PacketLossConfig(received_shares=(0.25,), lossy_share=1.0)
    config = dataclasses.replace(
        config, packet_loss=losses, milestones=dataclasses.replace(config.milestones, growth_end=5)
    )
    channel = PacketLossSimulator(config, TrainableHacpp(config, COMPILED, AnchorCache(config)), AnchorCache(config))
    assert state.iteration == config.milestones.growth_end + 1
    channel.before_iteration(state, dataset.cameras)
    importance = importance_of(state, config, dataset.cameras).share
    assert bool((importance[:-1] >= importance[1:]).all())
    received = channel.simulate(state, None)
    assert isinstance(received, ReceivedAnchors)
    count = round(0.25 * state.num_anchors)
    assert received.received.tolist() == [True] * count + [False] * (state.num_anchors - count)
    assert bool((received.size_gain[:count] > 1).any())
    assert bool((received.size_gain[count:] == 1).all())


@pytest.mark.parametrize(("since", "again"), [(1, True), (101, False), (201, False), (301, True), (601, True)])
def test_anchors_are_sorted_again_as_importance_changes(
    since: int, again: bool, state: TrainState, dataset: Dataset, config: TrainConfig
) -> None:
    losses = PacketLossConfig(received_shares=(0.25,))
    config = dataclasses.replace(
        config, packet_loss=losses, milestones=dataclasses.replace(config.milestones, growth_end=5)
    )
    channel = PacketLossSimulator(config, TrainableHacpp(config, COMPILED, AnchorCache(config)), AnchorCache(config))
    state.iteration = config.milestones.growth_end + since
    sort_by_importance(state, Importance.of_footprints(-importance_of(state, config, dataset.cameras).share + 1))
    channel.before_iteration(state, dataset.cameras)
    share = importance_of(state, config, dataset.cameras).share
    assert bool((share[:-1] >= share[1:]).all()) == again
