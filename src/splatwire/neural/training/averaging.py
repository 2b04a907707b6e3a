"""Averaging of parameters over the last iterations of a training, to reduce the influence of the last few photos."""

from dataclasses import replace

import torch

from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.state import TrainState


def averaging_start(config: TrainConfig, iteration: int = 0) -> int:
    """Returns the iteration after which the averaging of parameters starts in one phase of the training.

    The training has two phases: the main phase and the fine-tuning. Parameters are averaged at the end of each.

    Args:
        config: The configuration.
        iteration: Any iteration of the phase.
    """
    # Parameters are averaged over the last iterations before the fine-tuning, and again over the last iterations of
    # the fine-tuning. Iterations before the end of the growth are excluded.
    milestones = config.milestones
    if milestones.is_fine_tuning(iteration):
        return max(milestones.iterations - 2 * config.averaging_iterations, milestones.main_iterations)
    return max(milestones.main_iterations - 2 * config.averaging_iterations, milestones.growth_end)


@torch.no_grad()
def update_means(state: TrainState, config: TrainConfig) -> None:
    """Updates the running means of the parameters after an iteration.

    Args:
        state: State of the training; the means are changed in place.
        config: The configuration.
    """
    # The first `TrainConfig.averaging_iterations` iterations have equal weights; later, the mean is exponential.
    count = state.iteration - averaging_start(config, state.iteration)
    if count < 1 or not config.averaging_iterations:
        return
    names = [name for name in state.parameters if name in state.parameter_means]
    if names:
        means, values = ([source[name] for name in names] for source in (state.parameter_means, state.parameters))
        torch._foreach_lerp_(means, values, 1 / min(count, config.averaging_iterations))
    for name in state.parameters.keys() - state.parameter_means.keys():
        state.parameter_means[name] = state.parameters[name].detach().clone()


def with_averaged_parameters(state: TrainState) -> TrainState:
    """Returns the state with each parameter replaced by its running mean."""
    means = state.parameter_means
    return replace(state, parameters={**state.parameters, **means}) if means else state
