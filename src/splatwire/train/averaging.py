"""What a run leaves is the mean of its last iterations: what the last few photos pulled at evens out."""

from dataclasses import replace

import torch

from splatwire.train.config import TrainConfig
from splatwire.train.state import TrainState


def start_of_mean(config: TrainConfig, iteration: int = 0) -> int:
    """Iteration after which a running mean is taken: two lengths before the end, and not while anchors grow.

    Args:
        config: The recipe.
        iteration: Where the run is: a scene that goes on (`Marks.tuning`) has another mean.
    """
    marks = config.marks
    if marks.goes_on(iteration):
        return max(marks.iterations - 2 * config.averaged, marks.settled)
    return max(marks.settled - 2 * config.averaged, marks.growth_end)


@torch.no_grad()
def gather_mean(state: TrainState, config: TrainConfig) -> None:
    """Notes the parameters after an iteration.

    Of the first `TrainConfig.averaged` iterations that are noted all count alike; later, the earlier the less.

    Args:
        state: Its means are changed in place.
        config: The recipe.
    """
    count = state.iteration - start_of_mean(config, state.iteration)
    if count < 1 or not config.averaged:
        return
    known = [name for name in state.parameters if name in state.means]
    if known:
        means, values = ([source[name] for name in known] for source in (state.means, state.parameters))
        torch._foreach_lerp_(means, values, 1 / min(count, config.averaged))
    for name in state.parameters.keys() - state.means.keys():
        state.means[name] = state.parameters[name].detach().clone()


def averaged(state: TrainState) -> TrainState:
    """Returns the state with means, as far as there are any, in place of the parameters."""
    return replace(state, parameters={**state.parameters, **state.means}) if state.means else state
