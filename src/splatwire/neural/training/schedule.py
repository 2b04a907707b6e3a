"""Phases and learning rates of a training, by iteration."""

import dataclasses
import enum
import math

from splatwire.neural.training.config import LearningRate, LearningRates, Milestones, TrainConfig

SCALED_BY_EXTENT = ("offsets", "mask_logits")


class Phase(enum.Enum):
    """Phases of a training: no noise, noise of fixed width, context phase.

    In the context phase, the loss includes the rate. HAC++'s context model predicts the quantisation steps of each
    anchor; the causal model trains one set of steps for all anchors.
    """

    PLAIN = "plain"
    NOISE = "noise"
    CONTEXT = "context"


def phase_of(milestones: Milestones, iteration: int) -> Phase:
    """Returns the phase of an iteration; the first iteration is 1."""
    if iteration > milestones.context_start:
        return Phase.CONTEXT
    return Phase.NOISE if iteration > milestones.noise_start else Phase.PLAIN


def gathers_statistics(milestones: Milestones, iteration: int) -> bool:
    """True if the statistics for adding and removing anchors are gathered in an iteration."""
    return milestones.statistics_start < iteration < milestones.growth_end


def changes_anchors(milestones: Milestones, iteration: int) -> bool:
    """True if anchors are added and removed in an iteration, between backward pass and update of the parameters."""
    paused = milestones.noise_start <= iteration < milestones.growth_pause_end
    due = milestones.growth_start < iteration < milestones.growth_end and iteration % milestones.growth_interval == 0
    return due and not paused


def learning_rate_at(schedule: LearningRate, share: float) -> float:
    """Returns the learning rate after the given share (0 to 1) of the training, by log-linear interpolation."""
    share = min(max(share, 0.0), 1.0)
    return math.exp((1 - share) * math.log(schedule.initial) + share * math.log(schedule.final))


def half_cosine(share: float) -> float:
    """Returns the value of a half cosine, which falls from 1 at `share` 0 to 0 at `share` 1."""
    return 0.5 + 0.5 * math.cos(math.pi * share)


def fine_tuning_rates(rates: LearningRates) -> LearningRates:
    """Returns learning rates for fine-tuning.

    The rates are those of the second half of HAC++'s default schedule. Only the rate of the masks is that of the second
    half of `rates`.

    Args:
        rates: Learning rates of the training before the fine-tuning.
    """
    published = dataclasses.replace(LearningRates(), mask_logits=rates.mask_logits)
    halves = {name: LearningRate(math.sqrt(r.initial * r.final), r.final) for name, r in vars(published).items()}
    return LearningRates(**halves)


def learning_rates(config: TrainConfig, iteration: int, camera_extent: float) -> dict[str, float]:
    """Returns the learning rate of every parameter group in an iteration.

    Args:
        config: The configuration.
        iteration: Iteration, the first is 1.
        camera_extent: 1.1 times the largest distance of a training camera from the mean camera centre, world units.
    """
    milestones = config.milestones
    if milestones.is_fine_tuning(iteration):
        share = (iteration - milestones.main_iterations) / milestones.fine_tuning_iterations
        schedules = fine_tuning_rates(config.rates)
    else:
        share, schedules = iteration / milestones.main_iterations, config.rates
    rates = {name: learning_rate_at(schedule, share) for name, schedule in vars(schedules).items()}
    if iteration > milestones.growth_end:
        rates = {name: rate * getattr(schedules, name).late for name, rate in rates.items()}
    for name in SCALED_BY_EXTENT:
        rates[name] *= camera_extent
    return rates
