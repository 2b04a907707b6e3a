import dataclasses

import torch

from scenes import SMALL_CAUSAL
from splatwire.data import Dataset
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.initial import initial_state, parameter_shapes
from splatwire.neural.training.state import (
    ANCHOR_PARAMETERS,
    Moments,
    TrainState,
    append_anchors,
    group_of,
    keep_anchors,
)


def tagged_state(dataset: Dataset, config: TrainConfig) -> TrainState:
    """Training state with the index of its anchor in each row of each array."""
    state = initial_state(dataset, config)
    numbers = torch.arange(1.0, state.num_anchors + 1)

    def tag(rows: torch.Tensor) -> torch.Tensor:
        return numbers.view(-1, *[1] * (rows.dim() - 1)).expand(rows.shape).clone()

    for name in ANCHOR_PARAMETERS:
        state.parameters[name] = tag(state.parameters[name]).requires_grad_()
        state.parameter_means[name] = tag(state.parameters[name])
        state.moments[name] = Moments(tag(state.parameters[name]).detach(), -tag(state.parameters[name]).detach(), 7)
    for name, rows in vars(state.statistics).items():
        setattr(state.statistics, name, tag(rows))
    state.voxels = tag(state.voxels).long()
    return state


def rows_of(state: TrainState) -> list[torch.Tensor]:
    """One column of each array that has a row for every anchor."""
    columns = [state.parameters[name].detach() for name in ANCHOR_PARAMETERS]
    columns += [moments.first for moments in state.moments.values()]
    columns += [-moments.second for moments in state.moments.values()]
    columns += [*state.parameter_means.values(), *vars(state.statistics).values(), state.voxels.float()]
    return [c.reshape(len(c), -1)[:, -1] for c in columns]


def test_removing_anchors_keeps_state_aligned(dataset: Dataset, config: TrainConfig) -> None:
    state = tagged_state(dataset, config)
    keep = torch.arange(state.num_anchors) % 3 != 0
    expected = rows_of(state)[0][keep]
    keep_anchors(state, keep)
    for column in rows_of(state):
        assert torch.equal(column, expected)
    assert all(state.parameters[name].requires_grad for name in ANCHOR_PARAMETERS)
    assert all(moments.steps == 7 for moments in state.moments.values())


def test_added_anchors_have_fresh_optimiser_state(dataset: Dataset, config: TrainConfig) -> None:
    state = tagged_state(dataset, config)
    before = state.num_anchors
    new = {name: torch.full((5, *state.parameters[name].shape[1:]), 9.0) for name in ANCHOR_PARAMETERS}
    append_anchors(state, torch.full((5, 3), 9), new)
    assert state.num_anchors == before + 5
    for name in ANCHOR_PARAMETERS:
        assert bool((state.parameters[name][before:] == 9).all())
        assert bool((state.moments[name].first[before:] == 0).all())
        assert bool((state.moments[name].second[before:] == 0).all())
    assert all(bool((rows[before:] == 0).all()) for rows in vars(state.statistics).values())
    keep_anchors(state, torch.arange(before + 5) < before)
    for column in rows_of(state):
        assert torch.equal(column, torch.arange(1.0, before + 1))


def test_every_parameter_has_a_learning_rate(config: TrainConfig) -> None:
    causal = dataclasses.replace(config, model=SMALL_CAUSAL)
    groups = {group_of(name) for recipe in (config, causal) for name in parameter_shapes(recipe, 1)}
    assert groups - {"zero_points"} == set(vars(config.rates))  # zero points are measured, not trained
