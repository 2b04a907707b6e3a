"""Which phase an iteration belongs to, and how fast each group learns in it."""

import dataclasses
import enum
import math

from splatwire.train.config import LearningRate, LearningRates, Marks, TrainConfig

SCALED_BY_EXTENT = ("offsets", "mask_logits")


class Phase(enum.Enum):
    """The three phases of HAC++'s training."""

    PLAIN = "plain"
    NOISE = "noise"
    CONTEXT = "context"


def phase_of(marks: Marks, iteration: int) -> Phase:
    """Returns the phase of `iteration`, counted from 1."""
    if iteration > marks.context_start:
        return Phase.CONTEXT
    return Phase.NOISE if iteration > marks.noise_start else Phase.PLAIN


def gathers_statistics(marks: Marks, iteration: int) -> bool:
    """Tells whether gradients and opacities of `iteration` count for growing and pruning."""
    return marks.statistics_start < iteration < marks.growth_end


def changes_anchors(marks: Marks, iteration: int) -> bool:
    """Tells whether anchors are added and removed after `iteration`."""
    paused = marks.noise_start <= iteration < marks.growth_pause_end
    due = marks.growth_start < iteration < marks.growth_end and iteration % marks.growth_interval == 0
    return due and not paused


def learning_rate_at(rate: LearningRate, share: float) -> float:
    """Returns the learning rate after `share` (0 to 1) of the run: a straight line in the logarithm."""
    share = min(max(share, 0.0), 1.0)
    return math.exp((1 - share) * math.log(rate.initial) + share * math.log(rate.final))


def half_cosine(share: float) -> float:
    """Returns what is left after `share` (0 to 1) of a run of something that falls from 1 to 0 along half a cosine."""
    return 0.5 + 0.5 * math.cos(math.pi * share)


def second_half(rates: LearningRates) -> LearningRates:
    """Returns the rates with which a finished scene goes on: those of a published second half, and the own of masks."""
    published = dataclasses.replace(LearningRates(), mask_logits=rates.mask_logits)
    halves = {name: LearningRate(math.sqrt(r.initial * r.final), r.final) for name, r in vars(published).items()}
    return LearningRates(**halves)


def learning_rates(config: TrainConfig, iteration: int, camera_extent: float) -> dict[str, float]:
    """Returns the learning rate of every group in `iteration`.

    Args:
        config: The recipe.
        iteration: Counted from 1.
        camera_extent: 1.1 times the largest distance of a training camera from their mean, world units.
    """
    marks = config.marks
    if marks.goes_on(iteration):
        share, plan = (iteration - marks.settled) / marks.tuning, second_half(config.rates)
    else:
        share, plan = iteration / marks.settled, config.rates
    rates = {name: learning_rate_at(rate, share) for name, rate in vars(plan).items()}
    if iteration > marks.growth_end:
        rates = {name: rate * getattr(plan, name).late for name, rate in rates.items()}
    for name in SCALED_BY_EXTENT:
        rates[name] *= camera_extent
    return rates
